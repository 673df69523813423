// The joints: what is known of each, and how a register of many of them is read or written.
// Owns the joint table and the packets for the two series of this arm. Knows nothing of hosts or jobs.
#ifndef HEXWIRE_JOINTS_H
#define HEXWIRE_JOINTS_H

#include <stdint.h>

#include "generated.h"
#include "servo_bus.h"

namespace hexwire {

constexpr uint8_t kJoints = gen::JOINTS;
typedef uint16_t Mask;  // bit i = joint i
constexpr Mask kAllJoints = static_cast<Mask>((1UL << kJoints) - 1);
constexpr uint8_t kNoJoint = 0xFF;

inline Mask only(uint8_t joint) { return static_cast<Mask>(1U << joint); }

// What a sweep reads.
enum class Item : uint8_t {
  kPosition,
  kTorque,
  kTarget,
  kCeiling,      // HLS: the current ceiling
  kMotion,       // HLS: speed, load, voltage, temperature in one read
  kSupply,       // legacy: voltage and temperature
  kCurrent,
};
constexpr uint8_t kItems = 7;

struct Joint {
  uint8_t id;
  uint8_t series;
  int16_t position;
  int16_t speed;
  int16_t load;
  int16_t current;
  uint16_t ceiling;
  uint32_t sampled_ms;
  uint32_t sampled_us;
  uint32_t asked_ms;
  uint8_t voltage;
  int8_t temperature;
  uint8_t error;     // the error byte of the last answer
  bool known;        // the position has been read at least once
  bool present;      // answered the last time it was asked
  bool torque_on;
  bool ceiling_known;
  bool clamped;
};

// A target for some joints.
struct Targets {
  Mask mask;
  int16_t position[kJoints];
  uint16_t duration_ms[kJoints];
};

class Joints {
 public:
  Joints();

  Joint& operator[](uint8_t index) { return joints_[index]; }
  const Joint& operator[](uint8_t index) const { return joints_[index]; }
  uint8_t find(uint8_t servo_id) const;
  Mask with_series(uint8_t series) const;
  Mask present() const;

  // Whether `item` exists for the joint; address and size of its register.
  bool locate(uint8_t joint, Item item, uint8_t* address, uint8_t* size) const;

  // Takes an answer's parameters into the table; returns the value where the item is a single one.
  int16_t store(uint8_t joint, Item item, const uint8_t* parameters, uint8_t error, uint32_t now_us,
                uint32_t now_ms);
  void missed(uint8_t joint);

  // Put a packet into the bus's send buffer; false if there is nothing to send.
  bool make_read(ServoBus& bus, uint8_t joint, Item item) const;
  bool make_sync_read(ServoBus& bus, Mask mask, Item item) const;
  bool make_targets(ServoBus& bus, const Targets& targets, uint8_t series) const;
  bool make_torque(ServoBus& bus, Mask mask, bool on) const;

  // Distance in counts from where the joint was seen last.
  uint16_t distance(uint8_t joint, int16_t target) const;

 private:
  Joint joints_[kJoints];
};

// Reads one item of many joints, in as few transactions as the series allow.
class Sweep {
 public:
  Sweep(ServoBus& bus, Joints& joints);

  void begin(Mask mask, Item item, bool use_sync_read);
  // Starts the next transaction; false when all are through.
  bool start_next(uint32_t now_ms);
  // Takes the result of the transaction that this sweep started.
  void take_result(uint32_t now_us, uint32_t now_ms);

  Mask answered() const { return answered_; }
  int16_t value(uint8_t joint) const { return values_[joint]; }

 private:
  void take_one(uint8_t joint, uint8_t index, uint32_t now_us, uint32_t now_ms);

  ServoBus& bus_;
  Joints& joints_;
  Item item_;
  bool use_sync_read_;
  Mask todo_;
  Mask asked_;
  Mask answered_;
  int16_t values_[kJoints];
};

}  // namespace hexwire

#endif  // HEXWIRE_JOINTS_H
