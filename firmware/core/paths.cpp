#include "hot.h"  // first

// The trajectory's targets on the servo line. See PROTOCOL.md, section 6.7.
#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint8_t kNear = 64;             // most counts between a joint and the start of its path
constexpr uint16_t kMostSilentMs = 150;   // a joint that does not answer for so long ends the trajectory
constexpr uint32_t kMostGapUs = 18000;    // the next targets are sent then, although a polling cycle has not ended
constexpr int32_t kFreeBeforeUs = 6000;   // the servo line is kept free for so long before a start
constexpr uint8_t kTurnUs = 50;           // between two packets: until the first is known to be over, and the second begins
constexpr int32_t kMostOffUs = 100;       // targets that were computed ahead are sent no earlier or later than this

}  // namespace

// The reason why the joints cannot start on the path, of the first of them that cannot.
uint8_t Board::check_path_start() const {
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(trajectory_.joints() & only(i))) continue;
    const Joint& joint = joints_[i];
    if (joints_.other_mode(i)) return gen::STATUS_SERVO_FAULT;
    if (!can_move(i) || !joint.known) return gen::STATUS_SERVO_SILENT;
    if (!joint.torque_on) return gen::STATUS_TORQUE_OFF;
    if (joints_.distance(i, trajectory_.origin(i)) > kNear) return gen::STATUS_BAD_RANGE;
  }
  return gen::STATUS_OK;
}

bool Board::path_starts_soon() const {
  return trajectory_.waits() && trajectory_.until_start(last_us_) < kFreeBeforeUs;
}

void Board::leave_path(Mask mask) {
  if (!trajectory_.moving() || !(path_.joints & mask)) return;
  path_.joints &= static_cast<Mask>(~mask);
  if (path_.joints) {
    trajectory_.brake(gen::TRAJECTORY_FAULT);
  } else {
    trajectory_.end(gen::TRAJECTORY_FAULT);
  }
}

void Board::end_path() {
  trajectory_.end(gen::TRAJECTORY_STOPPED);
  path_.second = false;
}

// Begins and ends what is due; called in every pass.
void Board::watch_path() {
  if (trajectory_.waits()) {
    poller_.wake(ms_);
    if (trajectory_.until_start(last_us_) > 0) return;
    // Meanwhile points may have been replaced.
    if (!trajectory_.enough() || check_path_start() != gen::STATUS_OK) return trajectory_.end(gen::TRAJECTORY_FAULT);
    trajectory_.run();
    path_.joints = trajectory_.joints();
    path_.answered_ms = ms_;
    path_.written_us = last_us_;
    path_.cycle = static_cast<uint8_t>(poller_.cycles() - 1);
  }
  poller_.want(path_joints());
  if (!trajectory_.moving()) return;
  poller_.wake(ms_);
  const bool sent = path_.last_sent && !path_.second;
  if (sent && last_us_ - path_.written_us >= kTrajectoryLeadMs * 1000UL) trajectory_.finish();
}

// Whether targets are the next thing for the line.
bool Board::path_due() const {
  if (!trajectory_.moving()) return false;
  if (path_.second) return true;
  return !path_.last_sent && (path_.cycle != poller_.cycles() || last_us_ - path_.written_us >= kMostGapUs);
}

// Puts the packet together that follows the transaction that runs, if it is one with targets.
bool Board::prepare_path() {
  if (!path_due()) return false;
  if (path_.second) return make_path_targets(gen::SERIES_HLS);
  if (owner_ != Owner::kPoller) return false;
  path_.aimed_us = path_.begun_us + bus_.line_us() + bus_.answer_us() + path_.pause_us * bus_.answers();
  aim_path(gen::SERIES_SEVEN_BOT, path_.aimed_us);
  path_.ends = trajectory_.at_end();
  return make_path_targets(gen::SERIES_SEVEN_BOT);
}

// The time that a servo takes before it answers.
void Board::note_pause() {
  if (owner_ != Owner::kPoller || !path_due()) return;
  const uint32_t took = platform_.micros() - path_.begun_us - bus_.line_us() - bus_.answer_us();
  if (bus_.answers() && took < kMostGapUs) path_.pause_us = static_cast<uint16_t>(took / bus_.answers());
}

// Whether the prepared targets are still those of this moment.
bool Board::path_goes_on() const {
  const int32_t early = static_cast<int32_t>(path_.aimed_us - platform_.micros());
  return trajectory_.moving() && early < kMostOffUs && early > -kMostOffUs;
}

// The prepared targets are on the line. Those of the second series are computed meanwhile.
void Board::path_went_on() {
  if (path_.second) {
    path_.second = false;
    return;
  }
  path_.aimed_us = platform_.micros() + bus_.line_us() + kTurnUs;
  begin_pair();
  path_.last_sent = path_.ends;
  aim_path(gen::SERIES_HLS, path_.aimed_us);
  path_.second = trajectory_.moving();
}

// Sends the next targets, if they are due: of the legacy servos first, then of the others.
bool Board::write_path() {
  if (!path_due()) return false;
  if (path_.second) return send_second();
  begin_pair();
  if (!trajectory_.moving()) return false;
  const bool sent = aim_and_send(gen::SERIES_SEVEN_BOT);
  // If the second packet alone has the last position, there is another pair.
  path_.last_sent = trajectory_.at_end();
  // The second packet is computed while the first is on the line.
  path_.aimed_us = platform_.micros();
  if (sent) path_.aimed_us += bus_.line_us() + kTurnUs;
  aim_path(gen::SERIES_HLS, path_.aimed_us);
  path_.second = true;
  return sent || send_second();
}

// A request of the host may have come between the two packets: then the second gets the positions of its own time.
bool Board::send_second() {
  path_.second = false;
  return path_goes_on() ? send_path_targets(gen::SERIES_HLS) : aim_and_send(gen::SERIES_HLS);
}

// Computes the targets of one series and sends them at once: as far ahead as that took the last time.
bool Board::aim_and_send(uint8_t series) {
  uint16_t& takes = path_.takes_us[series == gen::SERIES_HLS];
  // To load a segment may take longer than all the rest, so that is done before time is taken.
  trajectory_.advance(platform_.micros() + takes);
  const uint32_t begun = platform_.micros();
  aim_path(series, begun + takes);
  const bool sent = send_path_targets(series);
  if (sent) takes = static_cast<uint16_t>(platform_.micros() - begun);
  return sent;
}

// The first packet of a pair is sent.
void Board::begin_pair() {
  if (last_us_ - path_.written_us > kTrajectoryLeadMs * 1000UL) ++path_.late;
  path_.written_us = last_us_;
  path_.cycle = poller_.cycles();
  const Mask lost = lost_joints();
  if (lost) leave_path(lost);
}

// Joints that cannot go on: their torque is off, or they have been silent for too long.
Mask Board::lost_joints() {
  Mask lost = 0;
  Mask silent = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(path_.joints & only(i))) continue;
    const Joint& joint = joints_[i];
    if ((joint.present && joint.torque_known && !joint.torque_on) || joints_.other_mode(i)) {
      lost |= only(i);
    } else if (!can_move(i)) {
      silent |= only(i);
    }
  }
  if (silent == 0) path_.answered_ms = ms_;
  return ms_ - path_.answered_ms > kMostSilentMs ? lost | silent : lost;
}

// Computes the targets of one series for a time.
void Board::aim_path(uint8_t series, uint32_t time_us) {
  trajectory_.advance(time_us);
  Targets& targets = path_.targets;
  targets.mask = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (joints_[i].series != series || !follows_path(i)) continue;
    const int16_t target = gate_.clamp(i, trajectory_.position(i));
    gate_.put_target(&targets, i, target, gate_.at_least(kTrajectoryLeadMs, i, target, ms_));
  }
}

// A joint that is silent may have lost its torque, which a target could switch on.
bool Board::follows_path(uint8_t i) const {
  return (path_.joints & only(i)) && can_move(i) && joints_[i].torque_on;
}

bool Board::send_path_targets(uint8_t series) {
  if (!make_path_targets(series)) return false;
  owner_ = Owner::kPath;
  return true;
}

// Starts the packet with the computed targets, or prepares it; false if there are none.
bool Board::make_path_targets(uint8_t series) {
  Targets& targets = path_.targets;
  for (uint8_t i = 0; i < kJoints; ++i) {
    // Something may have happened since they were computed.
    if (!follows_path(i)) targets.mask &= static_cast<Mask>(~only(i));
  }
  if (!joints_.make_targets(bus_, targets, series)) return false;
  bus_.start_silent();
  return true;
}

}  // namespace hexwire
