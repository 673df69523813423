// The immediate part of each command, and the job it starts. See PROTOCOL.md sections 5 and 6.3.
#include <string.h>

#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint8_t kFreshMs = 50;  // a JOINT_STATE is not answered from samples older than this
constexpr uint8_t kAllFields = gen::STATE_FIELD_SPEED | gen::STATE_FIELD_LOAD | gen::STATE_FIELD_VOLTAGE |
                               gen::STATE_FIELD_TEMPERATURE | gen::STATE_FIELD_CURRENT | gen::STATE_FIELD_AGE;
constexpr uint8_t kErrorBits = gen::SERVO_ERROR_VOLTAGE | gen::SERVO_ERROR_ENCODER | gen::SERVO_ERROR_TEMPERATURE |
                               gen::SERVO_ERROR_CURRENT | gen::SERVO_ERROR_OVERLOAD;
constexpr uint16_t kCapabilities = gen::CAPABILITY_REPORT | gen::CAPABILITY_JOINT_MOVE | gen::CAPABILITY_WATCHDOG |
                                   gen::CAPABILITY_LIMITS | gen::CAPABILITY_OFFSETS | gen::CAPABILITY_TRANSACT |
                                   gen::CAPABILITY_SYNC_READ | gen::CAPABILITY_IO | gen::CAPABILITY_MAINTENANCE |
                                   gen::CAPABILITY_TRAJECTORY | gen::CAPABILITY_FINE_POSITIONS |
                                   gen::CAPABILITY_SEVERAL | gen::CAPABILITY_FRAGMENTS |
                                   gen::CAPABILITY_SERVO_TABLE;
constexpr uint16_t kNever = 0xFFFF;

uint8_t* put_next(uint8_t* at, uint16_t value) {
  put16(at, value);
  return at + 2;
}

uint8_t status_of(const Joint& joint) {
  uint8_t status = joint.error & kErrorBits;
  if (joint.clamped) status |= gen::SERVO_FLAG_CLAMPED;
  if (joint.torque_on) status |= gen::SERVO_FLAG_TORQUE_ON;
  if (!joint.present) status |= gen::SERVO_FLAG_SILENT;
  return status;
}

// Milliseconds since the joint's last sample, as JOINT_STATE shows them.
uint16_t age_of(const Joint& joint, uint32_t now_ms) {
  if (!joint.known) return kNever;
  const uint32_t age = now_ms - joint.sampled_ms;
  return age < kNever ? static_cast<uint16_t>(age) : kNever - 1;
}

}  // namespace

void Board::execute() {
  if (now_running_.proto == gen::PROTO_CHAPTER) return execute_chapter();
  switch (now_running_.cmd) {
    case gen::CMD_PING:
    case gen::CMD_READ:
    case gen::CMD_TRANSACT:
      return pass_packet();
    case gen::CMD_SYNC_WRITE:
      return pass_move();
    case gen::CMD_JOINT_STATE:
      return joint_state();
    case gen::CMD_JOINT_MOVE:
      return joint_move();
    case gen::CMD_TORQUE:
      return torque();
    case gen::CMD_STOP:
      // A malformed STOP; a valid one does not go through the queue.
      return refuse(now_running_.size == gen::STOP_REQUEST_SIZE ? gen::STATUS_BAD_RANGE : gen::STATUS_BAD_LENGTH);
    case gen::CMD_RESUME:
      return resume();
    default:
      return execute_other();
  }
}

void Board::execute_path() {
  switch (now_running_.cmd) {
    case gen::CMD_TRAJECTORY_BEGIN:
      return begin_path();
    case gen::CMD_TRAJECTORY_POINTS:
      return add_to_path();
    case gen::CMD_TRAJECTORY_START:
      return start_path();
    case gen::CMD_TRAJECTORY_STATUS:
      return path_status();
    case gen::CMD_TRAJECTORY_ABORT:
      return abort_path();
    default:
      return execute_long();
  }
}

// Commands whose body or reply may be longer than a frame.
void Board::execute_long() {
  switch (now_running_.cmd) {
    case gen::CMD_FRAGMENT:
      return take_fragment();
    case gen::CMD_FRAGMENT_MISSING:
      return send_again();
    case gen::CMD_SERVO_TABLE:
      return servo_table();
    default:
      return refuse(gen::STATUS_UNKNOWN_COMMAND);
  }
}

// Commands that are about the board itself.
void Board::execute_other() {
  switch (now_running_.cmd) {
    case gen::CMD_IDENTIFY:
      return identify();
    case gen::CMD_REPORT:
      return set_report();
    case gen::CMD_WATCHDOG:
      return watchdog();
    case gen::CMD_LIMITS:
      return settings(Block::kLimits);
    case gen::CMD_OFFSETS:
      return settings(Block::kOffsets);
    case gen::CMD_STATS:
      return stats();
    case gen::CMD_IO:
      return io();
    case gen::CMD_MAINTENANCE:
      return maintenance();
    case gen::CMD_HOST_BAUD:
      return host_baud();
    default:
      return execute_path();
  }
}

// -- dialect 1 --------------------------------------------------------------------------------------

void Board::execute_chapter() {
  switch (now_running_.cmd) {
    case gen::CMD_PING:
    case gen::CMD_READ:
      return pass_packet();
    case gen::CMD_SYNC_WRITE:
      return pass_move();
    default:
      return reply_chapter(board_error(0xFF, gen::BOARD_ERROR_COMMAND_UNKNOWN));
  }
}

// -- dialect 2 --------------------------------------------------------------------------------------

void Board::identify() {
  if (now_running_.size) return refuse(gen::STATUS_BAD_LENGTH);
  poller_.set_report(0, last_us_);
  uint8_t* p = body();
  p[gen::IDENTIFY_REPLY_PROTOCOL] = gen::PROTO_HEXWIRE;
  p[gen::IDENTIFY_REPLY_FW_MAJOR] = gen::VERSION_MAJOR;
  p[gen::IDENTIFY_REPLY_FW_MINOR] = gen::VERSION_MINOR;
  p[gen::IDENTIFY_REPLY_FW_PATCH] = gen::VERSION_PATCH;
  put32(p + gen::IDENTIFY_REPLY_BOOT_ID, boot_id_);
  put16(p + gen::IDENTIFY_REPLY_CAPABILITIES, rate_.can_change() ? kCapabilities | gen::CAPABILITY_HOST_BAUD : kCapabilities);
  put16(p + gen::IDENTIFY_REPLY_MAX_FRAME, gen::MAX_SERIAL_FRAME);
  p[gen::IDENTIFY_REPLY_BOARD_FLAGS] = flags();
  p[gen::IDENTIFY_REPLY_JOINTS] = kJoints;
  uint8_t* row = p + gen::IDENTIFY_REPLY_SIZE;
  for (uint8_t i = 0; i < kJoints; ++i, row += gen::IDENTIFY_REPLY_ROW_SIZE) {
    row[gen::IDENTIFY_REPLY_ROW_SERVO_ID] = joints_[i].id;
    row[gen::IDENTIFY_REPLY_ROW_SERIES] = joints_[i].series;
    row[gen::IDENTIFY_REPLY_ROW_PRESENT] = joints_[i].present ? 1 : 0;
  }
  reply(gen::STATUS_OK, static_cast<uint8_t>(row - p));
}

uint8_t Board::put_state(uint8_t fields) {
  uint8_t* p = body();
  put32(p + gen::JOINT_STATE_REPLY_TIME_US, poller_.sampled_us());
  p[gen::JOINT_STATE_REPLY_FIELDS] = fields;
  p[gen::JOINT_STATE_REPLY_BOARD_FLAGS] = flags();
  p[gen::JOINT_STATE_REPLY_JOINTS] = kJoints;
  p[gen::JOINT_STATE_REPLY_SPARE] = 0;
  uint8_t* row = p + gen::JOINT_STATE_REPLY_SIZE;
  for (uint8_t i = 0; i < kJoints; ++i) row = put_joint(row, joints_[i], fields);
  return static_cast<uint8_t>(row - p);
}

// Writes the row of a joint; returns its end.
uint8_t* Board::put_joint(uint8_t* row, const Joint& joint, uint8_t fields) const {
  row = put_next(row, static_cast<uint16_t>(joint.position));
  *row++ = status_of(joint);
  if (fields & gen::STATE_FIELD_SPEED) row = put_next(row, static_cast<uint16_t>(joint.speed));
  if (fields & gen::STATE_FIELD_LOAD) row = put_next(row, static_cast<uint16_t>(joint.load));
  if (fields & gen::STATE_FIELD_VOLTAGE) *row++ = joint.voltage;
  if (fields & gen::STATE_FIELD_TEMPERATURE) *row++ = static_cast<uint8_t>(joint.temperature);
  if (fields & gen::STATE_FIELD_CURRENT) row = put_next(row, static_cast<uint16_t>(joint.current));
  if (fields & gen::STATE_FIELD_AGE) row = put_next(row, age_of(joint, ms_));
  return row;
}

void Board::joint_state() {
  if (now_running_.size != gen::JOINT_STATE_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t fields = now_running_.body[gen::JOINT_STATE_REQUEST_FIELDS];
  if (fields & ~kAllFields) return refuse(gen::STATUS_BAD_RANGE);
  poller_.wake(ms_);
  job_.argument = fields;
  if (ms_ - poller_.cycle_at_ms() <= kFreshMs && poller_.cycles()) return reply(gen::STATUS_OK, put_state(fields));
  start_job(kState, 0);
  job_.cycles = poller_.cycles();
}

void Board::set_report() {
  if (now_running_.size != gen::REPORT_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint16_t period = get16(now_running_.body + gen::REPORT_REQUEST_PERIOD_MS);
  const uint8_t fields = now_running_.body[gen::REPORT_REQUEST_FIELDS];
  if ((period != 0 && (period < 5 || period > 10000)) || (fields & ~kAllFields)) return refuse(gen::STATUS_BAD_RANGE);
  poller_.set_report(period, last_us_);
  report_fields_ = fields;
  report_to_ = now_running_.src;
  put16(body() + gen::REPORT_REPLY_PERIOD_MS, period);
  body()[gen::REPORT_REPLY_FIELDS] = fields;
  reply(gen::STATUS_OK, gen::REPORT_REPLY_SIZE);
}

// Checks the request and starts the move; the targets are computed when the bus is free.
void Board::joint_move() {
  const uint8_t* p = now_running_.body;
  const uint8_t size = now_running_.size;
  if (size < gen::JOINT_MOVE_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t count = p[gen::JOINT_MOVE_REQUEST_COUNT];
  if (count == 0 || size != gen::JOINT_MOVE_REQUEST_SIZE + count * gen::JOINT_MOVE_REQUEST_ROW_SIZE) {
    return refuse(gen::STATUS_BAD_LENGTH);
  }
  Mask mask = 0;
  for (uint8_t row = 0; row < count; ++row) {
    const uint8_t id = p[gen::JOINT_MOVE_REQUEST_SIZE + row * gen::JOINT_MOVE_REQUEST_ROW_SIZE];
    const uint8_t joint = joints_.find(id);
    const Mask named = id == gen::BROADCAST_ID ? kAllJoints : joint == kNoJoint ? 0 : only(joint);
    if (named == 0 || (mask & named)) return refuse(gen::STATUS_BAD_RANGE);
    mask |= named;
  }
  if (stopped()) return refuse(gen::STATUS_STOPPED);
  if (in_maintenance()) return refuse(gen::STATUS_FORBIDDEN);
  if (mask & path_joints()) return refuse(gen::STATUS_BUSY);
  poller_.wake(ms_);
  start_job(kMove, mask);
  skip_reads();
}

void Board::torque() {
  if (now_running_.size != gen::TORQUE_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t on = now_running_.body[gen::TORQUE_REQUEST_ON];
  const Mask mask = get16(now_running_.body + gen::TORQUE_REQUEST_MASK);
  if (on > 1 || (mask & ~kAllJoints)) return refuse(gen::STATUS_BAD_RANGE);
  if (on && stopped()) return refuse(gen::STATUS_STOPPED);
  if (on && in_maintenance()) return refuse(gen::STATUS_FORBIDDEN);
  if (on && (mask & path_joints())) return refuse(gen::STATUS_BUSY);
  if (!on) leave_path(mask);
  start_job(on ? kTorqueOn : kTorqueOff, mask);
}

void Board::resume() {
  if (now_running_.size) return refuse(gen::STATUS_BAD_LENGTH);
  board_flags_ &= static_cast<uint8_t>(
      ~(gen::BOARD_FLAG_STOPPED | gen::BOARD_FLAG_WATCHDOG_TRIPPED | gen::BOARD_FLAG_TORQUE_OFF_STOP));
  body()[gen::RESUME_REPLY_BOARD_FLAGS] = flags();
  reply(gen::STATUS_OK, gen::RESUME_REPLY_SIZE);
}

void Board::watchdog() {
  if (now_running_.size != gen::WATCHDOG_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint16_t timeout = get16(now_running_.body + gen::WATCHDOG_REQUEST_TIMEOUT_MS);
  const uint8_t mode = now_running_.body[gen::WATCHDOG_REQUEST_MODE];
  if ((timeout != 0 && (timeout < 50 || timeout > 60000)) || mode > 1) return refuse(gen::STATUS_BAD_RANGE);
  watchdog_ms_ = timeout;
  watchdog_mode_ = mode;
  memcpy(body(), now_running_.body, gen::WATCHDOG_REPLY_SIZE);
  reply(gen::STATUS_OK, gen::WATCHDOG_REPLY_SIZE);
}

void Board::settings(Block block) {
  const uint8_t size = now_running_.size;
  const uint8_t rows = Settings::rows_size(block);
  if (settings_.saving() == Saving::kBusy) {
    // A write of a request that a stop has cancelled: it is completed first.
    return start_job(kLater, 0);
  }
  settings_.forget_result();
  if (size) {
    const uint8_t row = rows / kJoints;
    const bool whole = size == 1 + now_running_.body[0] * row;
    if (whole && stopped()) return refuse(gen::STATUS_STOPPED);
    if (!whole || now_running_.body[0] != kJoints) return refuse(gen::STATUS_BAD_LENGTH);
    if (!Settings::valid(block, now_running_.body + 1)) return refuse(gen::STATUS_BAD_RANGE);
    if (!settings_.may_save(block, now_running_.body + 1, ms_)) return refuse(gen::STATUS_BUSY);
    settings_.save(block, now_running_.body + 1);
  }
  job_.argument = static_cast<uint8_t>(block);
  start_job(kSave, 0);
}

void Board::stats() {
  if (now_running_.size) return refuse(gen::STATUS_BAD_LENGTH);
  static_assert(gen::STATS_REPLY_SIZE == 4 + sizeof(Stats), "every counter is in the reply");
  put32(body(), ms_);
  const uint32_t* counter = &stats_.frames_received;
  for (uint8_t at = gen::STATS_REPLY_FRAMES_RECEIVED; at < gen::STATS_REPLY_SIZE; at = static_cast<uint8_t>(at + 4)) {
    put32(body() + at, *counter++);
  }
  reply(gen::STATUS_OK, gen::STATS_REPLY_SIZE);
}

void Board::io() {
  if (now_running_.size != gen::IO_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t mask = now_running_.body[gen::IO_REQUEST_MASK];
  if (mask & ~7) return refuse(gen::STATUS_BAD_RANGE);
  if (mask && stopped()) return refuse(gen::STATUS_STOPPED);
  outputs_ = static_cast<uint8_t>((outputs_ & ~mask) | (now_running_.body[gen::IO_REQUEST_VALUE] & mask));
  if (mask) platform_.set_outputs(outputs_);
  body()[gen::IO_REPLY_MASK] = mask;
  body()[gen::IO_REPLY_VALUE] = outputs_;
  reply(gen::STATUS_OK, gen::IO_REPLY_SIZE);
}

// A change while something moves could delay a stop, so what the joints do is read first.
void Board::host_baud() {
  if (now_running_.size != gen::HOST_BAUD_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  if (!rate_.can_change()) return refuse(gen::STATUS_NOT_SUPPORTED);
  const uint32_t wanted = get32(now_running_.body);
  if (!rate_.known(wanted)) return refuse(gen::STATUS_BAD_RANGE);
  if (wanted == rate_.now() || wanted == rate_.own()) return change_rate();
  start_job(kToRate, kAllJoints);
}

void Board::change_rate() {
  const uint32_t wanted = get32(now_running_.body);
  const bool back = wanted == rate_.now() || wanted == rate_.own();
  if (!back && (trajectory_.waits() || trajectory_.moving() || moved_since_note())) return refuse(gen::STATUS_BUSY);
  put32(body() + gen::HOST_BAUD_REPLY_RATE, wanted);
  reply(gen::STATUS_OK, gen::HOST_BAUD_REPLY_SIZE);
  if (wanted != rate_.now()) rate_.change(wanted);
}

void Board::maintenance() {
  if (now_running_.size != gen::MAINTENANCE_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t on = now_running_.body[gen::MAINTENANCE_REQUEST_ON];
  if (on > 1) return refuse(gen::STATUS_BAD_RANGE);
  if (on && stopped()) return refuse(gen::STATUS_STOPPED);
  if (on && !in_maintenance()) return start_job(kToMaintenance, kAllJoints);
  if (!on) end_maintenance();
  reply_maintenance();
}

void Board::end_maintenance() {
  if (!in_maintenance()) return;
  board_flags_ &= static_cast<uint8_t>(~gen::BOARD_FLAG_MAINTENANCE);
  poller_.digest();
  joints_.forget_settings();
}

void Board::reply_maintenance() {
  body()[gen::MAINTENANCE_REPLY_ON] = in_maintenance() ? 1 : 0;
  body()[gen::MAINTENANCE_REPLY_BOARD_FLAGS] = flags();
  reply(gen::STATUS_OK, gen::MAINTENANCE_REPLY_SIZE);
}

}  // namespace hexwire
