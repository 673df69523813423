// Fuzz target: an attacker sends valid frames, valid packets and noise to a board with seven servos that answer.
// In any mixture: the board reads and writes only its own memory, never hangs, and answers IDENTIFY afterwards;
// nothing moves or gains torque while it is stopped; nothing sent before a stop is executed after it; no target is
// beyond its limits or faster than its speed limit; no setting of a servo changes outside maintenance; and in dialect 2
// only TORQUE gives a joint torque. make_corpus.py writes seeds in the format that `Attack` reads.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <algorithm>
#include <cmath>

#include "../boards/host/host_board.h"
#include "bytes.h"
#include "fuzz_input.h"
#include "servo_model.h"

namespace hexwire {

struct BoardProbe {
  explicit BoardProbe(const Board& b) : board(b) {}
  uint8_t flags() const { return board.board_flags_; }
  int16_t minimum(uint8_t i) const { return board.settings_.minimum(i); }
  int16_t maximum(uint8_t i) const { return board.settings_.maximum(i); }
  uint32_t trips() const { return board.stats_.watchdog_trips; }
  uint16_t limit(uint8_t i) const { return board.settings_.speed(i); }
  const Board& board;
};

}  // namespace hexwire

namespace {

using namespace hexwire;

constexpr uint32_t kStepUs = 200;
constexpr uint32_t kIdleUs = 1000;
constexpr uint32_t kAnswerDelayUs = 250;
constexpr uint32_t kByteUs = 87;
constexpr uint8_t kMover = gen::BOARD_FLAG_STOPPED | gen::BOARD_FLAG_MAINTENANCE;

void broken(const char* what, long a = 0, long b = 0, long c = 0) {
  fprintf(stderr, "broken: %s (%ld, %ld, %ld)\n", what, a, b, c);
  abort();
}

// A board, its servos, and a watcher that checks what must never happen.
class World final : public ServoWatcher {
 public:
  World(uint8_t how, uint8_t servos)
      : dialect_1_(how & 1), probe_(b.board), line_(*this, make_servos(how, servos)), before_(0), clean_(true), seq_(0) {
    b.board.begin(1, 0);
    for (uint8_t i = 0; i < gen::JOINTS; ++i) remember_limits(i);
  }

  HostBoard b;

  ServoLine& line() { return line_; }
  // Something happens that the board cannot detect: what it knows of its servos may be wrong from here on.
  void spoil() { clean_ = false; }
  bool clean() const { return clean_; }
  bool dialect_1() const { return dialect_1_; }
  uint8_t flags() const { return probe_.flags(); }
  uint8_t next_seq() { return ++seq_; }

  void run(uint32_t us) {
    for (const uint64_t end = b.now_us + us; b.now_us < end;) b.now_us += step();
  }

  // Sends a valid frame and notes what it asks for.
  void put_frame(uint8_t proto, uint8_t cmd, const std::vector<uint8_t>& body, uint8_t seq) {
    if (body.size() > kMaxBody) return;
    uint8_t frame[gen::MAX_SERIAL_FRAME + 4];
    std::copy(body.begin(), body.end(), frame + kBodyAt);
    const FrameHead head = {0, 0, 0, 7, gen::MODULE_ARM_7BOT_ARDUINO_TRX, proto, seq, cmd, 0};
    const uint8_t whole = finish_frame(frame, head, static_cast<uint8_t>(body.size()));
    const Sent sent = {std::vector<uint8_t>(frame, frame + whole), proto, cmd, body, b.now_us, identified_};
    last_[next_last_++ % kLast] = sent;
    note(proto, cmd, body);
    put_raw(sent.frame);
  }
  void put_raw(const std::vector<uint8_t>& bytes) { b.from_host.insert(b.from_host.end(), bytes.begin(), bytes.end()); }
  // Sends an earlier frame again.
  void repeat(uint8_t ago) {
    const Sent& sent = last_[(next_last_ + kLast - 1u - ago % kLast) % kLast];
    if (sent.frame.empty()) return;
    // After this time, or after an IDENTIFY, it is a new request and not a repeat.
    const bool anew = b.now_us - sent.us > kRepeatUs || sent.identified != identified_;
    if (anew) note(sent.proto, sent.cmd, sent.body);
    put_raw(sent.frame);
  }

  void written(const ServoModel& before, const ServoModel& after, bool goal) override {
    const uint8_t i = index(after);
    // The state when the packet began counts: a packet that is already on the line is completed.
    const bool stopped = began_ & gen::BOARD_FLAG_STOPPED;
    const bool maintenance = began_ & gen::BOARD_FLAG_MAINTENANCE;
    if (!maintenance && memcmp(before.registers, after.registers, gen::HLS_REG_TORQUE_ENABLE) != 0) {
      broken("a setting changed outside maintenance", i);
    }
    if (!maintenance && before.registers[gen::HLS_REG_LOCK] != after.registers[gen::HLS_REG_LOCK]) broken("lock", i);
    if (!maintenance && !goal && changes_speed(before, after)) broken("a speed without a target", i);
    const bool gains = !before.torque_on() && after.torque_on();
    if (gains && (stopped || maintenance)) broken("torque while stopped or in maintenance", i, began_);
    if (gains && after.mode() != 0 && clean_) broken("torque in another mode", i, after.mode());
    if (gains && !dialect_1_ && !(began_granted_ & (1u << i))) broken("torque without TORQUE", i);
    if (goal && clean_) judge_goal(i, before, after, stopped);
  }

 private:
  static std::vector<ServoModel> make_servos(uint8_t how, uint8_t servos) {
    std::vector<ServoModel> made;
    for (uint8_t i = 0; i < gen::JOINTS; ++i) {
      made.push_back(ServoModel(i, i < 4, static_cast<int16_t>(1500 + 150 * i)));
      // As an earlier program left them.
      if (how & 2 && servos & (1u << i)) made.back().registers[gen::HLS_REG_TORQUE_ENABLE] = 1;
      if (how & 4 && i >= 4) {
        made.back().registers[gen::HLS_REG_MODE] = servos & 3;
        made.back().put_word(gen::HLS_REG_GOAL_SPEED, 20);
      }
    }
    return made;
  }

  static bool changes_speed(const ServoModel& before, const ServoModel& after) {
    if (after.legacy) return before.word(gen::SEVEN_BOT_REG_RUN_TIME) != after.word(gen::SEVEN_BOT_REG_RUN_TIME);
    return before.word(gen::HLS_REG_GOAL_SPEED) != after.word(gen::HLS_REG_GOAL_SPEED);
  }

  uint8_t index(const ServoModel& servo) const { return static_cast<uint8_t>(&servo - line_.servos.data()); }

  // Notes what the host has asked for, and so allows.
  void note(uint8_t proto, uint8_t cmd, const std::vector<uint8_t>& body) {
    if (proto != gen::PROTO_HEXWIRE) return;
    if (cmd == gen::CMD_IDENTIFY) ++identified_;
    if (cmd == gen::CMD_STOP && body.size() == 1 && body[0] <= 1) {
      granted_next_ = 0;
      aimed_next_ = resumed_ = false;
    } else if (cmd != gen::CMD_RESUME && cmd != gen::CMD_TORQUE) {
      aimed_ = aimed_next_ = true;
    }
    if (cmd == gen::CMD_RESUME && body.empty()) resumed_ = true;
    if (cmd == gen::CMD_TORQUE && body.size() == 3 && body[0] == 1) {
      granted_ |= body[1];
      granted_next_ |= body[1];
    }
  }

  // One pass of the board; returns the time until something happens.
  uint32_t step() {
    hear_board();
    hear_servos();
    before_ = flags();
    granted_before_ = granted_;
    aimed_before_ = aimed_;
    const uint8_t outputs = b.outputs;
    const bool rests = b.board.poll();
    const uint8_t now = flags();
    if (now & before_ & gen::BOARD_FLAG_STOPPED && outputs != b.outputs) broken("an output while stopped", b.outputs);
    if (probe_.trips() != trips_) resumed_ = false;
    trips_ = probe_.trips();
    if (before_ & ~now & gen::BOARD_FLAG_STOPPED && !resumed_) broken("a stop ended by an earlier request");
    if (now & gen::BOARD_FLAG_STOPPED) {
      granted_ = granted_next_;
      aimed_ = aimed_next_;
    }
    if ((now & kMover) == kMover) broken("maintenance while stopped");
    for (uint8_t i = 0; i < gen::JOINTS && b.storage_free_us + 2 * kIdleUs > b.now_us; ++i) {
      if (probe_.limit(i) != limits_[i][2] || probe_.minimum(i) != limits_[i][0] || probe_.maximum(i) != limits_[i][1]) {
        remember_limits(i);
      }
    }
    watch_still(now);
    take_from_board();
    uint64_t next = b.now_us + (rests && b.from_host.empty() ? kIdleUs : kStepUs);
    if (!packet_.empty()) next = std::min(next, packet_over_);
    if (!answer_.empty()) next = std::min(next, answer_at_);
    const uint32_t us = static_cast<uint32_t>(next > b.now_us ? next - b.now_us : 1);
    line_.step(us);
    // The host line drains, faster than a real one.
    const size_t drained = std::min<size_t>(b.to_host.size(), us / 40 + 1);
    seen_.insert(seen_.end(), b.to_host.begin(), b.to_host.begin() + static_cast<long>(drained));
    if (seen_.size() > 4096) seen_.erase(seen_.begin(), seen_.begin() + 2048);
    b.to_host.erase(b.to_host.begin(), b.to_host.begin() + static_cast<long>(drained));
    return us;
  }

  // Once a stop has had its time, nothing may move.
  void watch_still(uint8_t now) {
    if (!(now & gen::BOARD_FLAG_STOPPED) || !clean_) {
      still_from_ = b.now_us + kStopTakesUs;
      still_ = false;
      return;
    }
    if (b.now_us < still_from_) return;
    for (uint8_t i = 0; i < gen::JOINTS; ++i) {
      const double at = line_.servos[i].position;
      if (!still_) still_at_[i] = at;
      if (std::fabs(at - still_at_[i]) > 20) broken("moves while stopped", i, std::lround(at), std::lround(still_at_[i]));
    }
    still_ = true;
  }

  // A packet of the board reaches the servos with its last stop bit.
  void hear_board() {
    if (packet_.empty() || b.now_us < packet_over_) return;
    const std::vector<uint8_t> heard = line_.exchange(packet_);
    packet_.clear();
    if (heard.empty()) return;
    answer_ = heard;
    answer_at_ = b.now_us + kAnswerDelayUs + kByteUs * heard.size();
  }

  void hear_servos() {
    if (answer_.empty() || b.now_us < answer_at_) return;
    b.from_bus.insert(b.from_bus.end(), answer_.begin(), answer_.end());
    answer_.clear();
  }

  void take_from_board() {
    if (b.to_bus.empty()) return;
    // One pass may end a stop, or begin maintenance, and then send.
    const uint8_t now = flags();
    began_ = static_cast<uint8_t>(before_ & now & gen::BOARD_FLAG_STOPPED) |
             static_cast<uint8_t>((before_ | now) & gen::BOARD_FLAG_MAINTENANCE);
    began_granted_ = granted_before_;
    began_aimed_ = aimed_before_;
    packet_over_ = b.bus_free_us;
    packet_.swap(b.to_bus);
    b.to_bus.clear();
  }

  void remember_limits(uint8_t i) {
    for (uint8_t k = 0; k < 3; ++k) old_limits_[i][k] = limits_[i][k];
    limits_[i][0] = probe_.minimum(i);
    limits_[i][1] = probe_.maximum(i);
    limits_[i][2] = probe_.limit(i);
    limits_since_[i] = b.now_us;
  }

  void judge_goal(uint8_t i, const ServoModel& before, const ServoModel& after, bool stopped) {
    int32_t low = limits_[i][0], high = limits_[i][1], speed = limits_[i][2];
    if (b.now_us - limits_since_[i] < 100000) {
      low = std::min(low, old_limits_[i][0]);
      high = std::max(high, old_limits_[i][1]);
      speed = std::max(speed, old_limits_[i][2]);
    }
    const int16_t goal = after.goal();
    const double way = std::fabs(goal - before.position);
    // What a joint covers between its last sample and the end of this packet.
    const double age = before.torque_on() ? std::max(before.speed, 1.0 * speed) * 0.06 + 4 : 2;
    if (way > age) {
      if (!dialect_1_ && !began_aimed_) broken("a target that a stop voided", i, goal);
      if (stopped) broken("a target elsewhere while stopped", i, goal, std::lround(before.position));
      if (goal < low || goal > high) broken("a target beyond its limits", i, goal);
    }
    if (after.legacy) {
      const uint16_t run_time = after.word(gen::SEVEN_BOT_REG_RUN_TIME);
      // The register cannot hold a longer time.
      if (run_time == 0xFFFF || way <= age) return;
      if ((way - 4) * 1000 > speed * (run_time + 12.0)) broken("a move too fast", i, std::lround(way), run_time);
    } else {
      const uint16_t units = after.word(gen::HLS_REG_GOAL_SPEED) & (gen::HLS_REG_GOAL_SPEED_SIGN - 1);
      if (units == 0 || units > std::max(1, speed / 50)) broken("a speed beyond its limit", i, units, speed);
    }
  }

  // A frame that was sent.
  struct Sent {
    std::vector<uint8_t> frame;
    uint8_t proto;
    uint8_t cmd;
    std::vector<uint8_t> body;
    uint64_t us;
    uint32_t identified;
  };

  static constexpr size_t kLast = 8;
  static constexpr uint32_t kStopTakesUs = 1200000;
  static constexpr uint32_t kRepeatUs = gen::REPEAT_WINDOW_MS * 1000u;

  const bool dialect_1_;
  BoardProbe probe_;
  ServoLine line_;
  uint8_t before_;
  bool clean_;
  uint8_t seq_;
  uint8_t began_ = 0;
  bool resumed_ = false;
  uint32_t trips_ = 0;
  uint16_t granted_ = 0;
  uint16_t granted_next_ = 0;
  uint16_t granted_before_ = 0;
  uint16_t began_granted_ = 0;
  int32_t limits_[gen::JOINTS][3] = {};
  int32_t old_limits_[gen::JOINTS][3] = {};
  uint64_t limits_since_[gen::JOINTS] = {};
  uint64_t still_from_ = kStopTakesUs;
  bool still_ = false;
  double still_at_[gen::JOINTS] = {};
  Sent last_[kLast];
  size_t next_last_ = 0;
  uint32_t identified_ = 0;
  bool aimed_ = false;
  bool aimed_next_ = false;
  bool aimed_before_ = false;
  bool began_aimed_ = false;
  std::vector<uint8_t> packet_;
  uint64_t packet_over_ = 0;
  std::vector<uint8_t> answer_;
  uint64_t answer_at_ = 0;

 public:
  std::vector<uint8_t> seen_;
};

// Reads an input as a list of actions: number, time that passes afterwards, and arguments.
class Attack {
 public:
  Attack(World& world, Input& input) : w_(world), in_(input) {}

  void run() {
    for (int actions = 0; in_.size > 0 && actions < 120; ++actions) {
      const uint8_t what = in_.byte();
      act(what & 0x0F);
      w_.run(kStepUs * ((what >> 4) * (what >> 4) * (what >> 4) + 1u));
    }
  }

 private:
  void ask(uint8_t cmd, const std::vector<uint8_t>& body) {
    w_.put_frame(gen::PROTO_HEXWIRE, cmd, body, w_.next_seq());
  }

  // Sends a packet by one of the commands that carry packets.
  void pass(const std::vector<uint8_t>& packet, uint8_t way) {
    const uint8_t proto = w_.dialect_1() && way & 4 ? gen::PROTO_CHAPTER : gen::PROTO_HEXWIRE;
    const uint8_t cmds[] = {gen::CMD_TRANSACT, gen::CMD_READ, gen::CMD_SYNC_WRITE, gen::CMD_PING};
    const uint8_t cmd = cmds[way & 3];
    std::vector<uint8_t> body;
    if (cmd == gen::CMD_TRANSACT && proto == gen::PROTO_HEXWIRE) body = {static_cast<uint8_t>(way & 8 ? 6 : 0), 0};
    body.insert(body.end(), packet.begin(), packet.end());
    w_.put_frame(proto, proto == gen::PROTO_CHAPTER && cmd == gen::CMD_TRANSACT ? gen::CMD_READ : cmd, body, w_.next_seq());
  }

  void act(uint8_t what) {
    switch (what) {
      case 0: {  // any command, any body
        const uint8_t cmd = kCommands[in_.byte() % sizeof(kCommands)];
        ask(cmd, in_.bytes(in_.byte()));
        break;
      }
      case 1: {  // any packet to any servo
        const uint8_t way = in_.byte();
        const uint8_t id = in_.byte();
        const uint8_t instruction = kInstructions[in_.byte() & 15];
        pass(servo_packet(id, instruction, in_.bytes(in_.byte() % 200)), way);
        break;
      }
      case 2: {  // a plausible write
        const uint8_t way = in_.byte();
        const uint8_t id = in_.byte() % 9;
        const uint8_t address = in_.byte() % 64;
        std::vector<uint8_t> parameters = in_.bytes(in_.byte() % 12);
        parameters.insert(parameters.begin(), address);
        pass(servo_packet(id == 8 ? gen::BROADCAST_ID : id, gen::INST_WRITE, parameters), way);
        break;
      }
      case 3: {  // a plausible sync write
        const uint8_t way = in_.byte();
        const uint8_t address = in_.byte() % 64;
        const uint8_t each = in_.byte() % 10;
        std::vector<uint8_t> parameters = {address, each};
        for (uint8_t rows = in_.byte() % 12; rows; --rows) {
          parameters.push_back(in_.byte() % 9);
          for (uint8_t i = 0; i < each; ++i) parameters.push_back(in_.byte());
        }
        pass(servo_packet(gen::BROADCAST_ID, gen::INST_SYNC_WRITE, parameters), way);
        break;
      }
      case 4: {  // a move
        const uint16_t duration = in_.word();
        const uint8_t mask = in_.byte();
        std::vector<uint8_t> body = {static_cast<uint8_t>(duration), static_cast<uint8_t>(duration >> 8), 0};
        for (uint8_t i = 0; i < gen::JOINTS; ++i) {
          if (!(mask & (1u << i))) continue;
          const uint16_t target = in_.word();
          body.insert(body.end(), {i, static_cast<uint8_t>(target), static_cast<uint8_t>(target >> 8 & 0x1F)});
          ++body[2];
        }
        ask(gen::CMD_JOINT_MOVE, body);
        break;
      }
      case 5: {
        const uint8_t mask = in_.byte();
        ask(gen::CMD_TORQUE, {static_cast<uint8_t>(mask >> 7 ? 0 : 1), static_cast<uint8_t>(mask & 0x7F), 0});
        break;
      }
      case 6:
        ask(gen::CMD_STOP, {static_cast<uint8_t>(in_.byte() & 1)});
        break;
      case 7:
        ask(gen::CMD_RESUME, {});
        break;
      case 8: {
        const uint8_t timeout = in_.byte();
        ask(gen::CMD_WATCHDOG, {timeout, 0, static_cast<uint8_t>(timeout & 1)});
        break;
      }
      case 9:
        ask(gen::CMD_MAINTENANCE, {static_cast<uint8_t>(in_.byte() & 1)});
        break;
      case 10: {  // plausible limits
        const uint8_t low = in_.byte(), speed = in_.byte();
        std::vector<uint8_t> body = {gen::JOINTS};
        for (uint8_t i = 0; i < gen::JOINTS; ++i) {
          const uint16_t minimum = static_cast<uint16_t>(low * 8), maximum = static_cast<uint16_t>(minimum + 1500);
          const uint16_t counts = static_cast<uint16_t>(100 + speed * 16);
          body.insert(body.end(), {static_cast<uint8_t>(minimum), static_cast<uint8_t>(minimum >> 8),
                                   static_cast<uint8_t>(maximum), static_cast<uint8_t>(maximum >> 8),
                                   static_cast<uint8_t>(counts), static_cast<uint8_t>(counts >> 8)});
        }
        ask(gen::CMD_LIMITS, body);
        break;
      }
      case 11:  // noise from the host
        w_.put_raw(in_.bytes(in_.byte()));
        break;
      case 12: {  // noise from the servos
        w_.spoil();
        const std::vector<uint8_t> noise = in_.bytes(in_.byte());
        w_.b.from_bus.insert(w_.b.from_bus.end(), noise.begin(), noise.end());
        break;
      }
      case 13:  // an earlier frame again
        w_.repeat(in_.byte());
        break;
      case 14: {  // a servo falls silent or comes back
        w_.spoil();
        ServoModel& servo = w_.line().servos[in_.byte() % gen::JOINTS];
        servo.silent = !servo.silent;
        break;
      }
      default: {
        const uint8_t ms = in_.byte();
        if (ms < 200) {
          w_.run(ms * 1000u);
        } else {
          follow(in_.byte());
        }
        break;
      }
    }
  }

  // The parts of a trajectory, from where the joints are or from anywhere.
  void follow(uint8_t how) {
    const uint8_t mask = in_.byte() & 0x7F;
    const uint8_t flags = how & 3;
    if (how & 4) {
      mask_ = mask;
      flags_ = flags;
      next_ = 0;
      for (uint8_t i = 0; i < gen::JOINTS; ++i) at_[i] = static_cast<int16_t>(w_.line().servos[i].position);
      ask(gen::CMD_TRAJECTORY_BEGIN, {kPath, flags, mask, 0, static_cast<uint8_t>(in_.byte() + 20), 0});
    }
    if (how & 8) add_points(in_.byte() % 7, how & 32);
    if (how & 16) ask(gen::CMD_TRAJECTORY_START, {kPath, 1, 0, 0, 0, 0});
    if (how & 64) ask(gen::CMD_TRAJECTORY_ABORT, {kPath});
    if (how & 128) ask(gen::CMD_TRAJECTORY_STATUS, {});
  }

  void add_points(uint8_t count, bool last) {
    std::vector<uint8_t> body = {kPath, last, 0, 0, count};
    put16(&body[2], next_);
    for (uint8_t n = 0; n < count; ++n, ++next_) {
      const uint16_t dt = next_ ? in_.word() : 0;
      body.insert(body.end(), {static_cast<uint8_t>(dt), static_cast<uint8_t>(dt >> 8)});
      for (uint8_t i = 0; i < gen::JOINTS; ++i) {
        if (!(mask_ & (1u << i))) continue;
        const int8_t way = next_ ? static_cast<int8_t>(in_.byte()) : static_cast<int8_t>(0);
        at_[i] = static_cast<int16_t>(at_[i] + way * 4);
        body.insert(body.end(), {static_cast<uint8_t>(at_[i]), static_cast<uint8_t>(at_[i] >> 8)});
        if (flags_ & 1) body.insert(body.end(), {in_.byte(), static_cast<uint8_t>(way >> 6)});
      }
    }
    ask(gen::CMD_TRAJECTORY_POINTS, body);
  }

  static constexpr uint8_t kPath = 7;

  World& w_;
  Input& in_;
  uint8_t mask_ = 0;
  uint8_t flags_ = 0;
  uint16_t next_ = 0;
  int16_t at_[gen::JOINTS] = {};
};

bool answered(const std::vector<uint8_t>& out, uint8_t cmd, uint8_t seq) {
  for (size_t i = 0; i + kBodyAt <= out.size(); ++i) {
    if (get32(&out[i]) == gen::SYNC && out[i + 38] == cmd && out[i + 34] == seq) return true;
  }
  return false;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  Input input = {data, size};
  const uint8_t how = input.byte();
  World world(how, input.byte());
  if (how & 8) world.run(300000);
  Attack(world, input).run();
  // Let everything finish: waiting requests, time-outs, an unfinished frame, a half-written setting.
  world.run(600000);
  for (ServoModel& servo : world.line().servos) servo.silent = false;
  world.put_frame(gen::PROTO_HEXWIRE, gen::CMD_STOP, {static_cast<uint8_t>(how >> 4 & 1)}, 0x5B);
  world.run(1500000);
  if (!(world.flags() & gen::BOARD_FLAG_STOPPED)) broken("not stopped");
  if (world.clean()) {
    for (const ServoModel& servo : world.line().servos) {
      if (servo.torque_on() && servo.mode() != 0) broken("torque in another mode after a stop", servo.id());
      if (servo.torque_on() && how >> 4 & 1) broken("torque after a stop with torque off", servo.id());
    }
  }
  world.seen_.clear();
  world.put_frame(gen::PROTO_HEXWIRE, gen::CMD_IDENTIFY, {}, 0x5C);
  world.run(gen::DIALECT2_REPLY_WINDOW_MS * 1000u);
  if (!answered(world.seen_, gen::CMD_IDENTIFY, 0x5C)) broken("IDENTIFY is not answered");
  return 0;
}
