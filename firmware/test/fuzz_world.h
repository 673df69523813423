// The world of the fuzz target: a board, its servos, and a watcher that checks what must never happen. Owns time, both
// lines and what the host has asked for, and so allows. Must not know how an attack chooses.
#ifndef HEXWIRE_FUZZ_WORLD_H
#define HEXWIRE_FUZZ_WORLD_H

#include <stdint.h>

#include <vector>

#include "../boards/host/host_board.h"
#include "servo_model.h"

namespace hexwire {

constexpr uint32_t kStepUs = 200;

struct BoardProbe {
  explicit BoardProbe(const Board& b) : board(b) {}
  uint8_t flags() const { return board.board_flags_; }
  int16_t minimum(uint8_t i) const { return board.settings_.minimum(i); }
  int16_t maximum(uint8_t i) const { return board.settings_.maximum(i); }
  uint32_t trips() const { return board.stats_.watchdog_trips; }
  uint16_t limit(uint8_t i) const { return board.settings_.speed(i); }
  const Board& board;
};

// Something happened that must never happen: tells it, and ends the program.
void broken(const char* what, long a = 0, long b = 0, long c = 0, long d = 0);

class World final : public ServoWatcher {
 public:
  // `how`, bits: 0 the host may speak dialect 1; 1 `servos` have torque at start; 2 HLS servos are in mode `servos`.
  World(uint8_t how, uint8_t servos);

  HostBoard b;
  std::vector<uint8_t> seen;  // what the board has sent to the host lately

  ServoLine& line() { return line_; }
  // Something happens that the board cannot detect: what it knows of its servos may be wrong from here on.
  void spoil() { clean_ = false; }
  bool clean() const { return clean_; }
  bool dialect_1() const { return dialect_1_; }
  uint8_t flags() const { return probe_.flags(); }
  uint8_t next_seq() { return ++seq_; }
  uint8_t seq() const { return seq_; }
  // Whom the next frames are for.
  void aim(int32_t dst) { dst_ = dst; }

  void run(uint32_t us);
  // Sends a valid frame and notes what it asks for.
  void put_frame(uint8_t proto, uint8_t cmd, const std::vector<uint8_t>& body, uint8_t seq);
  void put_raw(const std::vector<uint8_t>& bytes);
  // Sends an earlier frame again.
  void repeat(uint8_t ago);

  void written(const ServoModel& before, const ServoModel& after, bool goal) override;

 private:
  // A frame that was sent.
  struct Sent {
    std::vector<uint8_t> frame;
    uint8_t proto;
    uint8_t cmd;
    std::vector<uint8_t> body;
    int32_t dst;
    uint64_t us;
    uint32_t identified;
  };
  // Limits of a joint, lowest, highest and fastest.
  struct Limits {
    int32_t low, high, speed;
  };

  static constexpr size_t kLast = 8;
  static constexpr uint32_t kStopTakesUs = 1200000;
  static constexpr uint32_t kRepeatUs = gen::REPEAT_WINDOW_MS * 1000u;

  static std::vector<ServoModel> make_servos(uint8_t how, uint8_t servos);
  uint8_t index(const ServoModel& servo) const { return static_cast<uint8_t>(&servo - line_.servos.data()); }
  void note(const Sent& sent);
  void note_motion(uint8_t cmd, const std::vector<uint8_t>& body);
  uint32_t step();
  void judge_flags(uint8_t outputs);
  void allow(uint8_t now);
  void follow_limits();
  uint32_t until_next(bool rests) const;
  void drain(uint32_t us);
  void watch_still(uint8_t now);
  void hear_board();
  void hear_servos();
  void take_from_board();
  void remember_limits(uint8_t i);
  void judge_settings(uint8_t i, const ServoModel& before, const ServoModel& after, bool goal);
  void judge_torque(uint8_t i, const ServoModel& before, const ServoModel& after);
  void judge_goal(uint8_t i, const ServoModel& before, const ServoModel& after);
  void judge_place(uint8_t i, const ServoModel& before, int16_t goal, const Limits& limits);
  Limits limits_of(uint8_t i) const;

  const bool dialect_1_;
  BoardProbe probe_;
  ServoLine line_;
  uint8_t before_ = 0;
  bool clean_ = true;
  uint8_t seq_ = 0;
  int32_t dst_ = gen::MODULE_ARM_7BOT_ARDUINO_TRX;
  uint8_t began_ = 0;  // flags when the packet on the servo line began
  bool resumed_ = false;
  uint32_t trips_ = 0;
  uint16_t granted_ = 0;  // joints that TORQUE may give torque
  uint16_t granted_next_ = 0;
  uint16_t granted_before_ = 0;
  uint16_t began_granted_ = 0;
  Limits limits_[gen::JOINTS] = {};
  Limits old_limits_[gen::JOINTS] = {};
  uint64_t limits_since_[gen::JOINTS] = {};
  uint64_t still_from_ = kStopTakesUs;
  bool still_ = false;
  double still_at_[gen::JOINTS] = {};
  Sent last_[kLast];
  size_t next_last_ = 0;
  uint32_t identified_ = 0;
  bool aimed_ = false;  // something was sent that may move a joint
  bool aimed_next_ = false;
  bool aimed_before_ = false;
  bool began_aimed_ = false;
  std::vector<uint8_t> packet_;
  uint64_t packet_over_ = 0;
  std::vector<uint8_t> answer_;
  uint64_t answer_at_ = 0;
};

}  // namespace hexwire

#endif  // HEXWIRE_FUZZ_WORLD_H
