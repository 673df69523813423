// The packet gate (PROTOCOL.md section 6.4): the only place that knows what torque, limits, speed, maintenance and a
// stop mean for a packet to a servo. Checks packets and rewrites those that move a joint, so that they keep the speed
// limit. Sends nothing; must not know frames or requests.
#ifndef HEXWIRE_GATE_H
#define HEXWIRE_GATE_H

#include <stdint.h>

#include "joints.h"
#include "servo_bus.h"
#include "settings.h"

namespace hexwire {

constexpr uint8_t kMaxHostAnswer = 120;  // of a servo, to a host's packet

// Instructions that change nothing.
inline bool is_read(uint8_t instruction) {
  return instruction == gen::INST_PING || instruction == gen::INST_READ || instruction == gen::INST_SYNC_READ;
}

// Whether a packet is complete, with correct length and checksum.
bool sound_packet(const uint8_t* packet, uint8_t size);

class Gate {
 public:
  // State of the board during the check.
  struct Circumstances {
    bool stopped;
    bool maintenance;
    bool chapter;  // the packet came in dialect 1
    Mask busy;     // joints that follow a trajectory
  };

  enum class Way : uint8_t {
    kAsItIs,
    kTargets,   // rewritten by `make_targets`
    kTorqueOn,  // sent after the present positions are written as targets
  };

  struct Verdict {
    uint8_t status;
    Way way;
    Mask mask;     // joints that move or get torque
    Mask unclear;  // of those, joints whose mode or torque must be read before the result is valid
    Mask silent;   // joints that a move leaves out
  };

  Gate(Joints& joints, const Settings& settings) : joints_(joints), settings_(settings) {}

  // Whether a packet is well formed for its instruction; checked before everything else.
  static bool well_formed(const uint8_t* packet, uint8_t size);
  // Whether it is the chapter's move: a sync write of position and run time to all servos.
  static bool is_move(const uint8_t* packet, uint8_t size);

  // Checks a well-formed packet of PING, READ and TRANSACT.
  Verdict judge(const uint8_t* packet, uint8_t size, const Circumstances& now) const;
  // Checks a write of these registers to one servo, in dialect 2.
  uint8_t judge_write(uint8_t id, uint8_t address, uint8_t size, const uint8_t* data, const Circumstances& now) const;
  // Checks the chapter's move, of the command SYNC_WRITE.
  Verdict judge_move(const uint8_t* packet, uint8_t size, const Circumstances& now) const;

  // Puts the packet for the joints of one series, which replaces a kTargets packet, into the bus's send buffer; false if
  // there is none.
  bool make_targets(ServoBus& bus, const uint8_t* packet, uint8_t series, uint32_t now_ms) const;
  // The targets of the chapter's move, for the joints of `mask`.
  void aim_move(const uint8_t* packet, uint8_t size, Mask mask, uint32_t now_ms, Targets* targets);

  // The nearest position inside the limits; records whether it differs.
  int16_t clamp(uint8_t joint, int32_t wanted);
  // A duration, lengthened if the joint would exceed its speed limit.
  uint32_t at_least(uint32_t duration_ms, uint8_t joint, int16_t target, uint32_t now_ms) const;
  // Adds a joint and its target, or changes its duration.
  void put_target(Targets* targets, uint8_t joint, int16_t position, uint32_t duration_ms) const;

 private:
  // One servo's part of a packet.
  struct Row {
    uint8_t id;
    uint8_t joint;
    uint8_t address;
    uint8_t size;
    const uint8_t* data;
    bool covers(uint8_t wanted) const { return address <= wanted && wanted - address < size; }
    const uint8_t* at(uint8_t wanted) const { return data + (wanted - address); }
  };

  Row row_of(uint8_t id, uint8_t address, uint8_t size, const uint8_t* data) const;
  uint8_t judge_row(const Row& row, const Circumstances& now, Verdict* verdict) const;
  uint8_t judge_register(const Row& row, uint8_t address, const Circumstances& now, Verdict* verdict) const;
  uint8_t judge_setting(const Row& row, uint8_t address, const Circumstances& now) const;
  uint8_t judge_torque(const Row& row, uint8_t value, const Circumstances& now, Verdict* verdict) const;
  uint8_t judge_target(const Row& row, const Circumstances& now, Verdict* verdict) const;
  void judge_moved(uint8_t joint, const Circumstances& now, Verdict* verdict) const;
  bool is_unclear(uint8_t joint, const Circumstances& now) const;
  bool legacy(uint8_t joint) const { return joints_[joint].series == gen::SERIES_SEVEN_BOT; }
  bool inside(uint8_t joint, int16_t target) const {
    return target >= settings_.minimum(joint) && target <= settings_.maximum(joint);
  }
  uint16_t fastest(uint8_t joint) const;
  bool find_row(const uint8_t* packet, uint8_t joint, Row* row) const;
  void add_block(ServoBus& bus, const Row& row, uint32_t now_ms) const;

  Joints& joints_;
  const Settings& settings_;
};

}  // namespace hexwire

#endif  // HEXWIRE_GATE_H
