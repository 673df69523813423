// An attack of the fuzz target: the input, read as a list of actions of a hostile host. make_corpus.py writes seeds in this
// format. Must not know what is forbidden.
#ifndef HEXWIRE_FUZZ_ATTACK_H
#define HEXWIRE_FUZZ_ATTACK_H

#include <stdint.h>

#include <vector>

#include "fuzz_input.h"
#include "fuzz_world.h"

namespace hexwire {

// Each action: number, time that passes afterwards, and arguments.
class Attack {
 public:
  Attack(World& world, Input& input) : w_(world), in_(input) {}

  void run();

 private:
  typedef void (Attack::*Action)();

  static const Action kActions[16];
  static constexpr uint8_t kPath = 7;  // number of its trajectories

  void ask(uint8_t cmd, const std::vector<uint8_t>& body);
  void pass(const std::vector<uint8_t>& packet, uint8_t way);

  void any_command();
  void any_packet();
  void write();
  void sync_write();
  void move();
  void torque();
  void stop();
  void resume();
  void watchdog();
  void maintenance();
  void limits();
  void noise();
  void servo_noise();
  void again();
  void silence();
  void longer();

  // Further actions, behind the last number.
  void aim(uint8_t how);
  void follow(uint8_t how);
  std::vector<uint8_t> points(uint8_t count, bool last);
  std::vector<uint8_t> still_points(uint8_t count);
  void message(uint8_t how);
  void begin_message(uint8_t kind);
  void send_chunk(uint16_t index);
  void table(uint8_t how);
  std::vector<uint8_t> table_body(bool writes);
  void ask_missing();
  void host_rate(uint8_t how);

  World& w_;
  Input& in_;
  uint8_t mask_ = 0;
  uint8_t flags_ = 0;
  uint16_t next_ = 0;
  int16_t at_[gen::JOINTS] = {};
  std::vector<uint8_t> message_;
  uint16_t message_id_ = 0;
  uint8_t message_cmd_ = 0;
  uint8_t chunk_ = 1;
  uint16_t sent_ = 0;
};

}  // namespace hexwire

#endif  // HEXWIRE_FUZZ_ATTACK_H
