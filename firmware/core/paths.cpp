#include "hot.h"  // first

// The trajectory's commands, and its targets on the servo line. See PROTOCOL.md, section 6.7.
#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint16_t kMostAheadS = 10;
constexpr uint8_t kNear = 64;             // most counts between a joint and the start of its path
constexpr uint16_t kMostSilentMs = 150;   // a joint that does not answer for so long ends the trajectory
constexpr uint32_t kMostGapUs = 18000;    // the next targets are sent then, although a polling cycle has not ended
constexpr int32_t kFreeBeforeUs = 6000;   // the servo line is kept free for so long before a start
constexpr uint8_t kTurnUs = 50;           // between two packets: until the first is known to be over, and the second begins
constexpr int32_t kMostOffUs = 100;       // targets that were computed ahead are sent no earlier or later than this
constexpr uint8_t kAllFlags =
    gen::TRAJECTORY_FLAG_HERMITE | gen::TRAJECTORY_FLAG_OUTLIVES_HOST | gen::TRAJECTORY_FLAG_FINE;

}  // namespace

// -- commands ---------------------------------------------------------------------------------------

void Board::begin_path() {
  if (now_running_.size != gen::TRAJECTORY_BEGIN_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t* p = now_running_.body;
  const uint8_t flags = p[gen::TRAJECTORY_BEGIN_REQUEST_FLAGS];
  const Mask mask = get16(p + gen::TRAJECTORY_BEGIN_REQUEST_MASK);
  const uint16_t brake = get16(p + gen::TRAJECTORY_BEGIN_REQUEST_BRAKE_MS);
  const bool known = mask != 0 && (mask & ~kAllJoints) == 0 && (flags & ~kAllFlags) == 0;
  if (!known || brake < kLeastBrakeMs || brake > kMostBrakeMs) return refuse(gen::STATUS_BAD_RANGE);
  if (stopped()) return refuse(gen::STATUS_STOPPED);
  if (in_maintenance()) return refuse(gen::STATUS_FORBIDDEN);
  if (trajectory_.moving()) return refuse(gen::STATUS_BUSY);
  path_ = Path();
  trajectory_.begin(p[gen::TRAJECTORY_BEGIN_REQUEST_ID], flags, mask, brake);
  body()[gen::TRAJECTORY_BEGIN_REPLY_ID] = trajectory_.id();
  body()[gen::TRAJECTORY_BEGIN_REPLY_STATE] = trajectory_.state();
  put16(body() + gen::TRAJECTORY_BEGIN_REPLY_CAPACITY, trajectory_.capacity());
  put16(body() + gen::TRAJECTORY_BEGIN_REPLY_LEAD_MS, kTrajectoryLeadMs);
  reply(gen::STATUS_OK, gen::TRAJECTORY_BEGIN_REPLY_SIZE);
}

void Board::add_to_path() {
  const uint8_t* p = now_running_.body;
  if (now_running_.size < gen::TRAJECTORY_POINTS_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t last = p[gen::TRAJECTORY_POINTS_REQUEST_LAST];
  if (p[gen::TRAJECTORY_POINTS_REQUEST_ID] != trajectory_.id() || last > 1) return refuse(gen::STATUS_BAD_RANGE);
  if (stopped()) return refuse(gen::STATUS_STOPPED);
  const uint8_t size = static_cast<uint8_t>(now_running_.size - gen::TRAJECTORY_POINTS_REQUEST_SIZE);
  const uint8_t status = trajectory_.add(p + gen::TRAJECTORY_POINTS_REQUEST_POINTS, size,
                                         get16(p + gen::TRAJECTORY_POINTS_REQUEST_FIRST),
                                         p[gen::TRAJECTORY_POINTS_REQUEST_COUNT], last);
  if (status != gen::STATUS_OK) return refuse(status);
  reply_path_status();
}

// Checks the request; what the joints do must perhaps be read first.
void Board::start_path() {
  if (now_running_.size != gen::TRAJECTORY_START_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t* p = now_running_.body;
  const bool known = p[gen::TRAJECTORY_START_REQUEST_ID] == trajectory_.id() && p[gen::TRAJECTORY_START_REQUEST_NOW] <= 1;
  if (!known) return refuse(gen::STATUS_BAD_RANGE);
  if (stopped()) return refuse(gen::STATUS_STOPPED);
  if (in_maintenance()) return refuse(gen::STATUS_FORBIDDEN);
  if (!trajectory_.ready() || !trajectory_.enough()) return refuse(gen::STATUS_BAD_RANGE);
  poller_.wake(ms_);
  start_job(kStartPath, trajectory_.joints());
  skip_reads();
}

void Board::set_path_start() {
  const uint8_t* p = now_running_.body;
  const uint32_t now = platform_.micros();
  const uint32_t at = p[gen::TRAJECTORY_START_REQUEST_NOW] ? now : get32(p + gen::TRAJECTORY_START_REQUEST_TIME_US);
  const uint8_t status = check_path_start();
  if (status != gen::STATUS_OK) return refuse(status);
  const int32_t ahead = static_cast<int32_t>(at - now);
  if (ahead < 0 || ahead >= kMostAheadS * 1000000L) return refuse(gen::STATUS_BAD_RANGE);
  trajectory_.start_at(at);
  body()[gen::TRAJECTORY_START_REPLY_ID] = trajectory_.id();
  body()[gen::TRAJECTORY_START_REPLY_STATE] = trajectory_.state();
  put32(body() + gen::TRAJECTORY_START_REPLY_TIME_US, at);
  reply(gen::STATUS_OK, gen::TRAJECTORY_START_REPLY_SIZE);
}

void Board::path_status() {
  if (now_running_.size) return refuse(gen::STATUS_BAD_LENGTH);
  reply_path_status();
}

void Board::reply_path_status() {
  uint8_t* p = body();
  p[gen::TRAJECTORY_STATUS_REPLY_ID] = trajectory_.id();
  p[gen::TRAJECTORY_STATUS_REPLY_STATE] = trajectory_.state();
  put16(p + gen::TRAJECTORY_STATUS_REPLY_NEXT, trajectory_.next());
  put16(p + gen::TRAJECTORY_STATUS_REPLY_INDEX, trajectory_.index());
  put16(p + gen::TRAJECTORY_STATUS_REPLY_FREE, trajectory_.free());
  put16(p + gen::TRAJECTORY_STATUS_REPLY_LATE, path_.late);
  put32(p + gen::TRAJECTORY_STATUS_REPLY_TIME_US, platform_.micros());
  reply(gen::STATUS_OK, gen::TRAJECTORY_STATUS_REPLY_SIZE);
}

void Board::abort_path() {
  if (now_running_.size != gen::TRAJECTORY_ABORT_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t id = now_running_.body[gen::TRAJECTORY_ABORT_REQUEST_ID];
  if (trajectory_.state() == gen::TRAJECTORY_NONE || id != trajectory_.id()) return refuse(gen::STATUS_BAD_RANGE);
  trajectory_.brake(gen::TRAJECTORY_ABORTED);
  body()[gen::TRAJECTORY_ABORT_REPLY_ID] = id;
  body()[gen::TRAJECTORY_ABORT_REPLY_STATE] = trajectory_.state();
  reply(gen::STATUS_OK, gen::TRAJECTORY_ABORT_REPLY_SIZE);
}

// -- the servo line ---------------------------------------------------------------------------------

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
  const uint32_t took = platform_.micros() - path_.begun_us - bus_.line_us() - bus_.answer_us();
  if (bus_.answers() && took < kMostGapUs) path_.pause_us = static_cast<uint16_t>(took) / bus_.answers();
}

// Whether the prepared targets are still those of this moment.
bool Board::path_goes_on() const {
  if (!trajectory_.moving() || path_.second) return trajectory_.moving();
  const int32_t early = static_cast<int32_t>(path_.aimed_us - platform_.micros());
  return early < kMostOffUs && early > -kMostOffUs;
}

// The prepared targets are on the line. Those of the second series are computed meanwhile.
void Board::path_went_on() {
  if (path_.second) {
    path_.second = false;
    return;
  }
  const uint32_t over = platform_.micros() + bus_.line_us() + kTurnUs;
  begin_pair();
  path_.last_sent = path_.ends;
  aim_path(gen::SERIES_HLS, over);
  path_.second = trajectory_.moving();
}

// Sends the next targets, if they are due: of the legacy servos first, then of the others.
bool Board::write_path() {
  if (!path_due()) return false;
  if (path_.second) return send_second();
  begin_pair();
  if (!trajectory_.moving()) return false;
  // To load a segment may take longer than all the rest, so that is done before time is taken.
  trajectory_.advance(platform_.micros() + path_.takes_us);
  // As far ahead as computing took the last time.
  const uint32_t begun = platform_.micros();
  aim_path(gen::SERIES_SEVEN_BOT, begun + path_.takes_us);
  // If the second packet alone has the last position, there is another pair.
  path_.last_sent = trajectory_.at_end();
  const bool sent = send_path_targets(gen::SERIES_SEVEN_BOT);
  const uint32_t now = platform_.micros();
  if (sent) path_.takes_us = static_cast<uint16_t>(now - begun);
  // The second packet is computed while the first is on the line.
  aim_path(gen::SERIES_HLS, sent ? now + bus_.line_us() + kTurnUs : now);
  path_.second = true;
  return sent || send_second();
}

bool Board::send_second() {
  path_.second = false;
  return send_path_targets(gen::SERIES_HLS);
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
