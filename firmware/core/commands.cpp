// What each command does at once, and which job it starts. See PROTOCOL.md sections 5 and 6.3.
#include <string.h>

#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint8_t kMaxRawAnswer = 120;
constexpr uint8_t kMinPacket = 6;
constexpr uint8_t kBoardErrorSize = 6;
constexpr uint8_t kFreshMs = 50;  // a JOINT_STATE is not answered from samples older than this
constexpr uint8_t kAllFields = gen::STATE_FIELD_SPEED | gen::STATE_FIELD_LOAD | gen::STATE_FIELD_VOLTAGE |
                               gen::STATE_FIELD_TEMPERATURE | gen::STATE_FIELD_CURRENT | gen::STATE_FIELD_AGE;
constexpr uint8_t kErrorBits = gen::SERVO_ERROR_VOLTAGE | gen::SERVO_ERROR_ENCODER | gen::SERVO_ERROR_TEMPERATURE |
                               gen::SERVO_ERROR_CURRENT | gen::SERVO_ERROR_OVERLOAD;
constexpr uint16_t kCapabilities = gen::CAPABILITY_REPORT | gen::CAPABILITY_JOINT_MOVE | gen::CAPABILITY_WATCHDOG |
                                   gen::CAPABILITY_LIMITS | gen::CAPABILITY_OFFSETS | gen::CAPABILITY_TRANSACT |
                                   gen::CAPABILITY_SYNC_READ | gen::CAPABILITY_IO;
constexpr uint16_t kNever = 0xFFFF;

bool sound_packet(const uint8_t* p, uint8_t size) {
  return size >= kMinPacket && p[0] == 0xFF && p[1] == 0xFF && p[2] != 0xFF && p[3] + 4 == size &&
         p[size - 1] == servo_checksum(p + 2, static_cast<uint8_t>(size - 3));
}

bool covers(uint8_t address, uint8_t size, uint8_t wanted) {
  return address <= wanted && wanted - address < size;
}

}  // namespace

void Board::execute() {
  if (now_running_.proto == gen::PROTO_CHAPTER) return execute_chapter();
  switch (now_running_.cmd) {
    case gen::CMD_PING:
    case gen::CMD_READ:
      return execute_packet();
    case gen::CMD_SYNC_WRITE:
      if (check_packet(now_running_.body, now_running_.size) != gen::STATUS_OK) return refuse(gen::STATUS_BAD_RANGE);
      return stopped() ? refuse(gen::STATUS_STOPPED) : start_job(kSyncWrite, kAllJoints);
    case gen::CMD_IDENTIFY:
      return identify();
    case gen::CMD_JOINT_STATE:
      return joint_state();
    case gen::CMD_REPORT:
      return set_report();
    case gen::CMD_JOINT_MOVE:
      return joint_move();
    case gen::CMD_TORQUE:
      return torque();
    case gen::CMD_STOP:
      if (now_running_.size != gen::STOP_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
      job_.argument = now_running_.body[gen::STOP_REQUEST_MODE];
      if (job_.argument > 1) return refuse(gen::STATUS_BAD_RANGE);
      return start_job(job_.argument ? kTorqueOff : kHold, kAllJoints);
    case gen::CMD_RESUME:
      return resume();
    case gen::CMD_WATCHDOG:
      return watchdog();
    case gen::CMD_LIMITS:
      return settings(Block::kLimits);
    case gen::CMD_OFFSETS:
      return settings(Block::kOffsets);
    case gen::CMD_TRANSACT:
      return transact();
    case gen::CMD_STATS:
      return stats();
    case gen::CMD_IO:
      return io();
    case gen::CMD_FRAGMENT:
    case gen::CMD_FRAGMENT_MISSING:
      return refuse(gen::STATUS_NOT_SUPPORTED);
    default:
      return refuse(gen::STATUS_UNKNOWN_COMMAND);
  }
}

// -- dialect 1 --------------------------------------------------------------------------------------

// A packet of the board's own. Its length byte is 6, but for a read: the chapter's board makes it so.
uint8_t Board::board_error(uint8_t id, uint8_t error) {
  const bool read = error == gen::BOARD_ERROR_READ_SILENT;
  uint8_t* p = body();
  p[0] = 0xFF;
  p[1] = 0xF5;
  p[2] = id;
  p[3] = read ? 4 : kBoardErrorSize;
  p[4] = error;
  p[5] = p[6] = 0;
  const uint8_t size = read ? 8 : kBoardErrorSize;
  p[size - 1] = servo_checksum(p + 2, static_cast<uint8_t>(size - 3));
  return size;
}

void Board::execute_chapter() {
  const Request& request = now_running_;
  switch (request.cmd) {
    case gen::CMD_PING:
    case gen::CMD_READ:
      if (!sound_packet(request.body, request.size)) {
        return reply_chapter(board_error(0xFF, gen::BOARD_ERROR_COMMAND_UNKNOWN));
      }
      return execute_packet();
    case gen::CMD_SYNC_WRITE:
      if (!stopped() && check_packet(request.body, request.size) == gen::STATUS_OK) {
        return start_job(kSyncWrite, kAllJoints);
      }
      return queue_.pop();
    default:
      return reply_chapter(board_error(0xFF, gen::BOARD_ERROR_COMMAND_UNKNOWN));
  }
}

void Board::refuse_packet(uint8_t status) {
  if (now_running_.proto == gen::PROTO_HEXWIRE) return refuse(status);
  const uint8_t error = now_running_.cmd == gen::CMD_PING ? gen::BOARD_ERROR_PING_SILENT : gen::BOARD_ERROR_READ_SILENT;
  reply_chapter(board_error(now_running_.body[2], error));
}

// PING and READ of both dialects: one packet to the bus, its answer back.
void Board::execute_packet() {
  const uint8_t* packet = now_running_.body;
  const uint8_t size = now_running_.size;
  uint8_t status = check_packet(packet, size);
  const uint8_t instruction = size > 4 ? packet[4] : 0;
  if (status == gen::STATUS_OK && stopped() && !is_read(instruction)) status = gen::STATUS_STOPPED;
  if (status != gen::STATUS_OK) return refuse_packet(status);

  start_job(kPacket, 0);
}

// Whether a packet from the host may go to the bus: whole, sound, and no target outside the limits.
uint8_t Board::check_packet(const uint8_t* p, uint8_t size) const {
  if (!sound_packet(p, size)) return gen::STATUS_BAD_RANGE;
  const uint8_t parameters = static_cast<uint8_t>(size - kMinPacket);
  bool ok = true;
  switch (p[4]) {
    case gen::INST_READ:
      ok = parameters == 2 && p[6] != 0 && p[6] <= kMaxRawAnswer - kMinPacket;
      break;
    case gen::INST_SYNC_READ:
      ok = parameters > 2 && parameters <= 2 + gen::MAX_JOINTS && p[6] != 0 &&
           (p[6] + kMinPacket) * (parameters - 2) <= kMaxRawAnswer;
      break;
    case gen::INST_WRITE:
    case gen::INST_REG_WRITE:
      ok = parameters >= 2 && target_allowed(p[2], p[5], p + 6, static_cast<uint8_t>(parameters - 1));
      break;
    case gen::INST_SYNC_WRITE: {
      const uint8_t each = static_cast<uint8_t>(p[6] + 1);
      ok = parameters > 2 && p[6] != 0 && (parameters - 2) % each == 0;
      // SYNC_WRITE of the chapter is little-endian for all ids, and is clamped rather than refused.
      if (now_running_.cmd == gen::CMD_SYNC_WRITE) {
        ok = ok && p[2] == gen::BROADCAST_ID && p[5] == gen::SEVEN_BOT_REG_TARGET_POSITION && p[6] == 4;
        break;
      }
      for (uint8_t at = 7; ok && at + each < size; at = static_cast<uint8_t>(at + each)) {
        ok = target_allowed(p[at], p[5], p + at + 1, p[6]);
      }
      break;
    }
    default:
      ok = now_running_.cmd != gen::CMD_SYNC_WRITE;
      break;
  }
  if (now_running_.cmd == gen::CMD_SYNC_WRITE && p[4] != gen::INST_SYNC_WRITE) ok = false;
  return ok ? gen::STATUS_OK : gen::STATUS_BAD_RANGE;
}

bool Board::target_allowed(uint8_t servo_id, uint8_t address, const uint8_t* data, uint8_t size) const {
  static_assert(gen::SEVEN_BOT_REG_TARGET_POSITION == gen::HLS_REG_GOAL_POSITION, "one address for both series");
  const uint8_t first = gen::HLS_REG_GOAL_POSITION;
  const bool low = covers(address, size, first);
  const bool high = covers(address, size, first + 1);
  if (!low && !high) return true;
  for (uint8_t i = 0; i < kJoints; ++i) {
    const Joint& joint = joints_[i];
    if (servo_id != joint.id && servo_id != gen::BROADCAST_ID) continue;
    // Half a position cannot be judged.
    if (!low || !high) return false;
    const uint8_t* p = data + (first - address);
    const int16_t target = joint.series == gen::SERIES_SEVEN_BOT
                               ? static_cast<int16_t>(get16_big(p))
                               : decode_signed(get16(p), gen::HLS_REG_GOAL_POSITION_SIGN);
    if (target < settings_.minimum(i) || target > settings_.maximum(i)) return false;
  }
  return true;
}

// A host may switch torque by a packet of its own; the table must know.
void Board::note_write(const uint8_t* p) {
  const uint8_t size = static_cast<uint8_t>(p[3] + 4);
  if (p[4] == gen::INST_WRITE) return note_register(p[2], p[5], p + 6, static_cast<uint8_t>(size - 7));
  if (p[4] != gen::INST_SYNC_WRITE) return;
  for (uint8_t at = 7; at + p[6] < size - 1; at = static_cast<uint8_t>(at + p[6] + 1)) {
    note_register(p[at], p[5], p + at + 1, p[6]);
  }
}

void Board::note_register(uint8_t servo_id, uint8_t address, const uint8_t* data, uint8_t size) {
  if (!covers(address, size, gen::HLS_REG_TORQUE_ENABLE)) return;
  const uint8_t value = data[gen::HLS_REG_TORQUE_ENABLE - address];
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (servo_id == joints_[i].id || servo_id == gen::BROADCAST_ID) joints_[i].torque_on = value == 1;
  }
}

// -- dialect 2 --------------------------------------------------------------------------------------

void Board::identify() {
  if (now_running_.size) return refuse(gen::STATUS_BAD_LENGTH);
  poller_.set_report(0, last_us_);
  uint8_t* p = body();
  p[gen::IDENTIFY_REPLY_PROTOCOL] = gen::PROTO_HEXWIRE;
  p[gen::IDENTIFY_REPLY_FW_MAJOR] = kVersionMajor;
  p[gen::IDENTIFY_REPLY_FW_MINOR] = kVersionMinor;
  p[gen::IDENTIFY_REPLY_FW_PATCH] = kVersionPatch;
  put32(p + gen::IDENTIFY_REPLY_BOOT_ID, boot_id_);
  put16(p + gen::IDENTIFY_REPLY_CAPABILITIES, kCapabilities);
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
  for (uint8_t i = 0; i < kJoints; ++i) {
    const Joint& joint = joints_[i];
    put16(row, static_cast<uint16_t>(joint.position));
    row[2] = static_cast<uint8_t>((joint.error & kErrorBits) | (joint.clamped ? gen::SERVO_FLAG_CLAMPED : 0) |
                                  (joint.torque_on ? gen::SERVO_FLAG_TORQUE_ON : 0) |
                                  (joint.present ? 0 : gen::SERVO_FLAG_SILENT));
    row += 3;
    if (fields & gen::STATE_FIELD_SPEED) {
      put16(row, static_cast<uint16_t>(joint.speed));
      row += 2;
    }
    if (fields & gen::STATE_FIELD_LOAD) {
      put16(row, static_cast<uint16_t>(joint.load));
      row += 2;
    }
    if (fields & gen::STATE_FIELD_VOLTAGE) *row++ = joint.voltage;
    if (fields & gen::STATE_FIELD_TEMPERATURE) *row++ = static_cast<uint8_t>(joint.temperature);
    if (fields & gen::STATE_FIELD_CURRENT) {
      put16(row, static_cast<uint16_t>(joint.current));
      row += 2;
    }
    if (fields & gen::STATE_FIELD_AGE) {
      const uint32_t age = ms_ - joint.sampled_ms;
      const uint16_t shown = age < kNever ? static_cast<uint16_t>(age) : kNever - 1;
      put16(row, joint.known ? shown : kNever);
      row += 2;
    }
  }
  return static_cast<uint8_t>(row - p);
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

// Checks the request and starts the move; the targets are worked out when the bus is free.
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
  for (uint8_t i = 0; i < kJoints; ++i) {
    if ((mask & only(i)) && joints_[i].present && !joints_[i].torque_on) return refuse(gen::STATUS_TORQUE_OFF);
  }
  poller_.wake(ms_);
  start_job(kMove, mask);
}

void Board::torque() {
  if (now_running_.size != gen::TORQUE_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t on = now_running_.body[gen::TORQUE_REQUEST_ON];
  const Mask mask = get16(now_running_.body + gen::TORQUE_REQUEST_MASK);
  if (on > 1 || (mask & ~kAllJoints)) return refuse(gen::STATUS_BAD_RANGE);
  if (on && stopped()) return refuse(gen::STATUS_STOPPED);
  job_.argument = on;
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
  board_flags_ &= static_cast<uint8_t>(~gen::BOARD_FLAG_WATCHDOG_TRIPPED);
  memcpy(body(), now_running_.body, gen::WATCHDOG_REPLY_SIZE);
  reply(gen::STATUS_OK, gen::WATCHDOG_REPLY_SIZE);
}

void Board::settings(Block block) {
  const uint8_t size = now_running_.size;
  const uint8_t rows = Settings::rows_size(block);
  if (settings_.saving() == Saving::kIdle && size) {
    const uint8_t row = rows / kJoints;
    const bool whole = size == 1 + now_running_.body[0] * row;
    if (whole && stopped()) return refuse(gen::STATUS_STOPPED);
    if (!whole || now_running_.body[0] != kJoints) return refuse(gen::STATUS_BAD_LENGTH);
    if (!Settings::valid(block, now_running_.body + 1)) return refuse(gen::STATUS_BAD_RANGE);
    settings_.save(block, now_running_.body + 1);
  }
  // A stop in between makes this request run anew: then it waits for the saving it began.
  job_.argument = static_cast<uint8_t>(block);
  start_job(kSave, 0);
}

void Board::transact() {
  const uint8_t* p = now_running_.body;
  if (now_running_.size < gen::TRANSACT_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t length = p[gen::TRANSACT_REQUEST_REPLY_LENGTH];
  const uint8_t* packet = p + gen::TRANSACT_REQUEST_PACKET;
  const uint8_t size = static_cast<uint8_t>(now_running_.size - gen::TRANSACT_REQUEST_SIZE);
  const uint8_t status = check_packet(packet, size);
  if (status != gen::STATUS_OK) return refuse(status);
  if (length > kMaxRawAnswer) return refuse(gen::STATUS_BAD_RANGE);
  if (stopped() && !is_read(packet[4])) return refuse(gen::STATUS_STOPPED);
  start_job(kRaw, 0);
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

}  // namespace hexwire
