#include "fuzz_world.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <algorithm>
#include <cmath>
#include <iterator>

#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint32_t kIdleUs = 1000;
constexpr uint32_t kAnswerDelayUs = 250;
constexpr uint32_t kByteUs = 87;
constexpr uint8_t kMover = gen::BOARD_FLAG_STOPPED | gen::BOARD_FLAG_MAINTENANCE;

bool changes_speed(const ServoModel& before, const ServoModel& after) {
  if (after.legacy) return before.word(gen::SEVEN_BOT_REG_RUN_TIME) != after.word(gen::SEVEN_BOT_REG_RUN_TIME);
  return before.word(gen::HLS_REG_GOAL_SPEED) != after.word(gen::HLS_REG_GOAL_SPEED);
}

bool is_stop(uint8_t cmd, const std::vector<uint8_t>& body) {
  return cmd == gen::CMD_STOP && body.size() == 1 && body[0] <= 1;
}

// Whether the board may execute such a frame (PROTOCOL.md section 6.9). Not the board's own function, which may be wrong.
bool is_for_board(int32_t dst, uint8_t cmd) {
  static const uint8_t kForSeveral[] = {0x03, 0x10, 0x11, 0x12, 0x13, 0x14, 0x15, 0x16, 0x17, 0x1B, 0x22, 0x23, 0x24};
  if (dst == 8) return true;
  const bool named = dst == -1 || (static_cast<uint32_t>(dst) >> 30 == 1 && (dst & 0x100));
  return named && std::count(std::begin(kForSeveral), std::end(kForSeveral), cmd);
}

// The time of a move that is too short for its way is an error.
void judge_time(uint8_t i, double way, const ServoModel& before, const ServoModel& after, int32_t speed) {
  const uint16_t run_time = after.word(gen::SEVEN_BOT_REG_RUN_TIME);
  // The register cannot hold a longer time.
  if (run_time == 0xFFFF) return;
  // What it covered since its last sample: it may still move as fast as it might before the limits changed.
  const double faster = before.torque_on() ? std::max(0.0, before.speed - speed) * 0.02 : 0;
  if ((way - faster - 4) * 1000 > speed * (run_time + 12.0)) {
    broken("a move too fast", i, std::lround(way), run_time, std::lround(before.speed));
  }
}

}  // namespace

void broken(const char* what, long a, long b, long c, long d) {
  fprintf(stderr, "broken: %s (%ld, %ld, %ld, %ld)\n", what, a, b, c, d);
  abort();
}

World::World(uint8_t how, uint8_t servos)
    : dialect_1_(how & 1), probe_(b.board), line_(*this, make_servos(how, servos)) {
  b.board.begin(1, 0);
  for (uint8_t i = 0; i < gen::JOINTS; ++i) remember_limits(i);
}

std::vector<ServoModel> World::make_servos(uint8_t how, uint8_t servos) {
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

// -- the host line ----------------------------------------------------------------------------------

void World::run(uint32_t us) {
  for (const uint64_t end = b.now_us + us; b.now_us < end;) b.now_us += step();
}

void World::put_frame(uint8_t proto, uint8_t cmd, const std::vector<uint8_t>& body, uint8_t seq) {
  if (body.size() > kMaxBody) return;
  uint8_t frame[gen::MAX_SERIAL_FRAME + 4];
  std::copy(body.begin(), body.end(), frame + kBodyAt);
  const FrameHead head = {0, 0, 0, 7, dst_, proto, seq, cmd, 0};
  const uint8_t whole = finish_frame(frame, head, static_cast<uint8_t>(body.size()));
  const Sent sent = {std::vector<uint8_t>(frame, frame + whole), proto, cmd, body, dst_, b.now_us, identified_};
  last_[next_last_++ % kLast] = sent;
  note(sent);
  put_raw(sent.frame);
}

void World::put_raw(const std::vector<uint8_t>& bytes) {
  b.from_host.insert(b.from_host.end(), bytes.begin(), bytes.end());
}

void World::repeat(uint8_t ago) {
  const Sent& sent = last_[(next_last_ + kLast - 1u - ago % kLast) % kLast];
  if (sent.frame.empty()) return;
  // After this time, or after an IDENTIFY, it is a new request and not a repeat.
  const bool anew = b.now_us - sent.us > kRepeatUs || sent.identified != identified_;
  if (anew) note(sent);
  put_raw(sent.frame);
}

// Notes what the host has asked this board for, and so allows.
void World::note(const Sent& sent) {
  if (sent.proto != gen::PROTO_HEXWIRE) return;
  if (!is_for_board(sent.dst, sent.cmd)) return;
  if (sent.cmd == gen::CMD_IDENTIFY) ++identified_;
  note_motion(sent.cmd, sent.body);
}

void World::note_motion(uint8_t cmd, const std::vector<uint8_t>& body) {
  if (is_stop(cmd, body)) {
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

// -- time -------------------------------------------------------------------------------------------

// One pass of the board; returns the time until something happens.
uint32_t World::step() {
  hear_board();
  hear_servos();
  before_ = flags();
  granted_before_ = granted_;
  aimed_before_ = aimed_;
  const uint8_t outputs = b.outputs;
  const bool rests = b.board.poll();
  judge_flags(outputs);
  allow(flags());
  follow_limits();
  watch_still(flags());
  take_from_board();
  const uint32_t us = until_next(rests);
  line_.step(us);
  drain(us);
  return us;
}

void World::judge_flags(uint8_t outputs) {
  const uint8_t now = flags();
  if (now & before_ & gen::BOARD_FLAG_STOPPED && outputs != b.outputs) broken("an output while stopped", b.outputs);
  if (probe_.trips() != trips_) resumed_ = false;
  trips_ = probe_.trips();
  if (before_ & ~now & gen::BOARD_FLAG_STOPPED && !resumed_) broken("a stop ended by an earlier request");
  if ((now & kMover) == kMover) broken("maintenance while stopped");
}

// While it is stopped, only what was sent since the stop counts.
void World::allow(uint8_t now) {
  if (!(now & gen::BOARD_FLAG_STOPPED)) return;
  granted_ = granted_next_;
  aimed_ = aimed_next_;
}

void World::follow_limits() {
  for (uint8_t i = 0; i < gen::JOINTS && b.storage_free_us + 2 * kIdleUs > b.now_us; ++i) {
    const Limits& known = limits_[i];
    const bool same =
        probe_.limit(i) == known.speed && probe_.minimum(i) == known.low && probe_.maximum(i) == known.high;
    if (!same) remember_limits(i);
  }
}

uint32_t World::until_next(bool rests) const {
  uint64_t next = b.now_us + (rests && b.from_host.empty() ? kIdleUs : kStepUs);
  if (!packet_.empty()) next = std::min(next, packet_over_);
  if (!answer_.empty()) next = std::min(next, answer_at_);
  return static_cast<uint32_t>(next > b.now_us ? next - b.now_us : 1);
}

// The host line drains, faster than a real one.
void World::drain(uint32_t us) {
  const size_t drained = std::min<size_t>(b.to_host.size(), us / 40 + 1);
  seen.insert(seen.end(), b.to_host.begin(), b.to_host.begin() + static_cast<long>(drained));
  if (seen.size() > 4096) seen.erase(seen.begin(), seen.begin() + 2048);
  b.to_host.erase(b.to_host.begin(), b.to_host.begin() + static_cast<long>(drained));
}

// Once a stop has had its time, nothing may move.
void World::watch_still(uint8_t now) {
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

// -- the servo line ---------------------------------------------------------------------------------

// A packet of the board reaches the servos with its last stop bit.
void World::hear_board() {
  if (packet_.empty() || b.now_us < packet_over_) return;
  const std::vector<uint8_t> heard = line_.exchange(packet_);
  packet_.clear();
  if (heard.empty()) return;
  answer_ = heard;
  answer_at_ = b.now_us + kAnswerDelayUs + kByteUs * heard.size();
}

void World::hear_servos() {
  if (answer_.empty() || b.now_us < answer_at_) return;
  b.from_bus.insert(b.from_bus.end(), answer_.begin(), answer_.end());
  answer_.clear();
}

void World::take_from_board() {
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

// -- what a packet may do ---------------------------------------------------------------------------

// The state when the packet began counts: a packet that is already on the line is completed.
void World::written(const ServoModel& before, const ServoModel& after, bool goal) {
  const uint8_t i = index(after);
  // Of two servos with one id nobody can say what they obey: a legacy one has its bytes in the other order.
  for (const ServoModel& other : line_.servos) {
    if (&other != &after && other.id() == after.id()) spoil();
  }
  judge_settings(i, before, after, goal);
  judge_torque(i, before, after);
  if (goal && clean_) judge_goal(i, before, after);
}

void World::judge_settings(uint8_t i, const ServoModel& before, const ServoModel& after, bool goal) {
  if (began_ & gen::BOARD_FLAG_MAINTENANCE) return;
  if (memcmp(before.registers, after.registers, gen::HLS_REG_TORQUE_ENABLE) != 0) {
    broken("a setting changed outside maintenance", i);
  }
  if (before.registers[gen::HLS_REG_LOCK] != after.registers[gen::HLS_REG_LOCK]) broken("lock", i);
  if (!goal && changes_speed(before, after)) broken("a speed without a target", i);
}

void World::judge_torque(uint8_t i, const ServoModel& before, const ServoModel& after) {
  if (before.torque_on() || !after.torque_on()) return;
  if (began_ & kMover) broken("torque while stopped or in maintenance", i, began_);
  if (after.mode() != 0 && clean_) broken("torque in another mode", i, after.mode());
  if (!dialect_1_ && !(began_granted_ & (1u << i))) broken("torque without TORQUE", i);
}

void World::remember_limits(uint8_t i) {
  old_limits_[i] = limits_[i];
  limits_[i] = Limits{probe_.minimum(i), probe_.maximum(i), probe_.limit(i)};
  limits_since_[i] = b.now_us;
}

// A packet that was made before they changed may still be on the line.
World::Limits World::limits_of(uint8_t i) const {
  Limits limits = limits_[i];
  if (b.now_us - limits_since_[i] >= 100000) return limits;
  limits.low = std::min(limits.low, old_limits_[i].low);
  limits.high = std::max(limits.high, old_limits_[i].high);
  limits.speed = std::max(limits.speed, old_limits_[i].speed);
  return limits;
}

void World::judge_goal(uint8_t i, const ServoModel& before, const ServoModel& after) {
  const Limits limits = limits_of(i);
  const int16_t goal = after.goal();
  const double way = std::fabs(goal - before.position);
  // What a joint covers between its last sample and the end of this packet.
  const double age = before.torque_on() ? std::max(before.speed, 1.0 * limits.speed) * 0.06 + 4 : 2;
  if (way > age) judge_place(i, before, goal, limits);
  if (after.legacy) {
    if (way > age) judge_time(i, way, before, after, limits.speed);
    return;
  }
  const uint16_t units = after.word(gen::HLS_REG_GOAL_SPEED) & (gen::HLS_REG_GOAL_SPEED_SIGN - 1);
  if (units == 0 || units > std::max(1, limits.speed / 50)) broken("a speed beyond its limit", i, units, limits.speed);
}

void World::judge_place(uint8_t i, const ServoModel& before, int16_t goal, const Limits& limits) {
  if (!dialect_1_ && !began_aimed_) broken("a target that a stop voided", i, goal);
  if (began_ & gen::BOARD_FLAG_STOPPED) broken("a target elsewhere while stopped", i, goal, std::lround(before.position));
  if (goal < limits.low || goal > limits.high) broken("a target beyond its limits", i, goal);
}

}  // namespace hexwire
