// The joints: the state of each, and reading or writing a register of many of them.
// Owns the joint table and the packets for the two series of this arm. Must not know hosts or jobs.
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
constexpr uint16_t kHlsSpeedUnit = 50;  // counts/s

inline Mask only(uint8_t joint) { return static_cast<Mask>(1U << joint); }

// What a sweep reads; joints.cpp has their registers in this order.
enum class Item : uint8_t {
  kPosition,
  kTorque,
  kTarget,
  kCeiling,      // HLS: the current ceiling
  kMotion,       // position; HLS: also speed, load, voltage, temperature in one read
  kSupply,       // legacy: voltage and temperature
  kCurrent,
  kMode,         // HLS: 0 is position mode
};

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
  bool torque_known;
  bool ceiling_known;
  bool mode_known;
  bool in_position;  // mode; the other series have no other
  bool moves;        // its last two samples differ
  bool clamped;
  uint8_t sync_misses;  // sync reads in a row that it did not answer although it answers alone
};

// A target for some joints.
struct Targets {
  Mask mask;
  int16_t position[kJoints];
  uint16_t duration_ms[kJoints];
  uint16_t speed[kJoints];  // HLS: in its own units
};

class Joints {
 public:
  static constexpr uint8_t kMostSyncMisses = 8;

  Joints();

  Joint& operator[](uint8_t index) { return joints_[index]; }
  const Joint& operator[](uint8_t index) const { return joints_[index]; }
  uint8_t find(uint8_t servo_id) const;
  Mask with_series(uint8_t series) const;
  // A joint that is present, but of which something has not been read since it appeared that a target requires; and
  // what. kNoJoint if there is none.
  uint8_t lacking(Item* item) const;
  bool is_lacking() const;

  // Whether a joint is known to be in a mode other than position mode; whether its mode must be read first.
  bool other_mode(uint8_t joint) const { return joints_[joint].mode_known && !joints_[joint].in_position; }
  bool mode_unknown(uint8_t joint) const { return has(joint, Item::kMode) && !joints_[joint].mode_known; }
  // Something else may have changed the servos' settings: read them again.
  void forget_settings();

  // Whether the joint's series has the item.
  bool has(uint8_t joint, Item item) const;

  // Stores an answer's parameters in the table; returns the value if the item is a single one.
  int16_t store(uint8_t joint, Item item, const uint8_t* parameters, uint8_t error, uint32_t now_us,
                uint32_t now_ms);
  // The joint did not answer. It may have lost its power in the meantime, so what is known of it is forgotten.
  void missed(uint8_t joint);

  // Not every firmware of a servo knows SYNC_READ: one that does not is asked alone. `try_sync_again` asks once more.
  bool syncs(uint8_t joint) const { return joints_[joint].sync_misses < kMostSyncMisses; }
  void missed_sync(uint8_t joint) {
    if (syncs(joint)) ++joints_[joint].sync_misses;
  }
  void try_sync_again();

  // Put a packet into the bus's send buffer; return the number of parameters of each answer.
  uint8_t make_read(ServoBus& bus, uint8_t joint, Item item) const;
  uint8_t make_sync_read(ServoBus& bus, const uint8_t* joints, uint8_t count, Item item) const;
  // The same for packets without an answer; false if there is nothing to send.
  bool make_targets(ServoBus& bus, const Targets& targets, uint8_t series) const;
  bool make_torque(ServoBus& bus, Mask mask, bool on) const;

  // Speed with which an HLS joint reaches its target in that time, in the servo's units.
  uint16_t hls_speed(uint8_t joint, int16_t target, uint16_t duration_ms) const;
  // Distance in counts from the joint's last known position.
  uint16_t distance(uint8_t joint, int16_t target) const;

 private:
  void locate(uint8_t joint, Item item, uint8_t* address, uint8_t* size) const;
  static int16_t store_other(Joint& joint, Item item, const uint8_t* parameters, uint16_t raw);
  static void store_motion(Joint& joint, const uint8_t* parameters);
  static void store_position(Joint& joint, uint16_t raw, uint32_t now_us, uint32_t now_ms);

  Joint joints_[kJoints];
};

// Reads one item of many joints, in as few transactions as the series allow. The time between the last byte of an
// answer and the first of the next request is the board's own delay, so it is kept short: the next request is prepared
// while the answer is awaited, the answer is only copied, and `digest` parses it while the next request is being sent.
class Sweep {
 public:
  static constexpr uint8_t kLongestItem = 8;

  // The answer of one joint, as it came.
  struct Raw {
    uint8_t joint;
    uint8_t size;  // 0 = no answer
    uint8_t error;
    uint8_t data[kLongestItem];
  };

  // `raw` has room for an answer of each joint. Sweeps may share it if each is digested before another takes a result.
  Sweep(ServoBus& bus, Joints& joints, Raw* raw);

  void begin(Mask mask, Item item, bool use_sync_read);
  // Starts the next transaction; false when all are done.
  bool start_next(uint32_t now_ms);
  // Prepares the transaction after the one that runs, which is this sweep's own or not; false if there is none.
  bool prepare(uint32_t now_ms, bool own);
  // Whether the transaction that runs is the last, and reads one joint.
  bool at_last() const;
  // As `begin`, while such a transaction runs: its result is still taken.
  void begin_after(Mask mask, Item item, bool use_sync_read);
  bool ends_last() const { return last_ != kNoJoint; }
  // Stores the result of the transaction that this sweep started.
  void take_result(uint32_t now_us, uint32_t now_ms);
  // The prepared transaction of this sweep has been started.
  void went_on() { many_asked_ = many_count_ != 0; }
  // Parses the stored result into the joint table.
  void digest();

  // Valid after `digest`.
  Mask answered() const { return answered_; }
  int16_t value(uint8_t joint) const { return values_[joint]; }

 private:
  void take_one(uint8_t joint, const uint8_t* packet);
  void take_many();
  void make_single(uint8_t joint, uint32_t now_ms);
  void make_many(uint32_t now_ms);

  ServoBus& bus_;
  Joints& joints_;
  Item item_;
  Item taken_item_;
  uint8_t order_[kJoints];  // joints still to be asked one by one
  uint8_t next_;
  uint8_t count_;
  uint8_t many_[kJoints];   // joints to be asked by one sync read
  uint8_t many_count_;
  bool many_asked_;
  uint8_t last_;            // joint of the sweep before that still has to answer
  Mask answered_;
  uint8_t undigested_;
  uint32_t taken_us_;
  uint32_t taken_ms_;
  Raw* const raw_;
  int16_t values_[kJoints];
};

}  // namespace hexwire

#endif  // HEXWIRE_JOINTS_H
