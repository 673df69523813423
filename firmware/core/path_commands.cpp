// The trajectory's commands. See PROTOCOL.md, section 6.7.
#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint16_t kMostAheadS = 10;
constexpr uint8_t kAllFlags =
    gen::TRAJECTORY_FLAG_HERMITE | gen::TRAJECTORY_FLAG_OUTLIVES_HOST | gen::TRAJECTORY_FLAG_FINE;

}  // namespace

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
  if (inbox_.cmd() == gen::CMD_TRAJECTORY_POINTS) drop_message();
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

}  // namespace hexwire
