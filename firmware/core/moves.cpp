#include "hot.h"  // first

// The steps of moves and of torque, with their answers: targets of the joints, and what must be known before.
#include <string.h>

#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint8_t kFreshMs = 50;  // no distance is computed from a position older than this

}  // namespace

// Joints of the job that are present, but for which this item is not known.
Mask Board::lacking(Lack what) const {
  Mask mask = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    const Joint& joint = joints_[i];
    if (!joint.present) continue;
    const bool known = what == Lack::kTorque   ? joint.torque_known
                       : what == Lack::kMode   ? joint.mode_known || !joints_.has(i, Item::kMode)
                                               : joint.ceiling_known || !joints_.has(i, Item::kCeiling);
    if (!known) mask |= only(i);
  }
  return mask & job_.mask;
}

Mask Board::stale() const {
  Mask mask = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (joints_[i].present && ms_ - joints_[i].sampled_ms > kFreshMs) mask |= only(i);
  }
  return mask & job_.mask;
}

// Skips the reading steps of a job if everything they read is already known. One check costs less than one per step.
void Board::skip_reads() {
  for (uint8_t i = 0; i < kJoints; ++i) {
    const Joint& joint = joints_[i];
    if (!(job_.mask & only(i)) || !joint.present) continue;
    const bool known = joint.torque_known && (joint.series == gen::SERIES_SEVEN_BOT || (joint.mode_known && joint.ceiling_known));
    if (!known || ms_ - joint.sampled_ms > kFreshMs) return;
  }
  while (job_.program[job_.pc] <= Step::kReadTaken) ++job_.pc;
}

Mask Board::torqued() const {
  Mask mask = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (joints_[i].torque_on) mask |= only(i);
  }
  return mask & job_.mask;
}

// The present position becomes the target, except for a servo in another mode, where a target has another meaning.
void Board::aim(Mask mask) {
  for (uint8_t i = 0; i < kJoints; ++i) {
    const Joint& joint = joints_[i];
    if (!(mask & only(i)) || !joint.present || !joint.known || joints_.other_mode(i)) continue;
    if (joint.ceiling_known || !joints_.has(i, Item::kCeiling)) gate_.put_target(&job_.targets, i, joint.position, 0);
  }
}

// Puts the targets of one series into the send buffer; false if there are none.
bool Board::make_targets(uint8_t series) {
  if (!joints_.make_targets(bus_, job_.targets, series)) return false;
  note_targets(job_.targets.mask & joints_.with_series(series));
  return true;
}

void Board::aim_move() {
  const uint8_t* p = now_running_.body;
  for (uint8_t i = 0; i < kJoints; ++i) {
    // The torque may have been read only now.
    const Joint& joint = joints_[i];
    if ((job_.mask & only(i)) && joint.present && joint.torque_known && !joint.torque_on) {
      return refuse(gen::STATUS_TORQUE_OFF);
    }
  }
  uint32_t duration = get16(p + gen::JOINT_MOVE_REQUEST_DURATION_MS);
  for (uint8_t row = 0; row < p[gen::JOINT_MOVE_REQUEST_COUNT]; ++row) {
    const uint8_t* at = p + gen::JOINT_MOVE_REQUEST_SIZE + row * gen::JOINT_MOVE_REQUEST_ROW_SIZE;
    duration = aim_row(at[0], static_cast<int16_t>(get16(at + gen::JOINT_MOVE_REQUEST_ROW_POSITION)), duration);
  }
  job_.duration_ms = duration > 0xFFFF ? 0xFFFF : static_cast<uint16_t>(duration);
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (job_.targets.mask & only(i)) gate_.put_target(&job_.targets, i, job_.targets.position[i], duration);
  }
  next_step();
}

// Aims the joints of a row of JOINT_MOVE; returns the duration that they need.
uint32_t Board::aim_row(uint8_t id, int16_t wanted, uint32_t duration) {
  for (uint8_t i = 0; i < kJoints; ++i) {
    if ((id != joints_[i].id && id != gen::BROADCAST_ID) || !can_move(i)) continue;
    job_.targets.mask |= only(i);
    job_.targets.position[i] = gate_.clamp(i, wanted);
    duration = gate_.at_least(duration, i, job_.targets.position[i], ms_);
  }
  return duration;
}

// Whether everything is known that a target for a joint requires.
bool Board::can_move(uint8_t i) const {
  const Joint& joint = joints_[i];
  if (!joint.present || !joint.torque_known || joints_.other_mode(i)) return false;
  return joint.ceiling_known || !joints_.has(i, Item::kCeiling);
}

void Board::confirm_torque() {
  const bool on = job_.program == kTorqueOn;
  Mask confirmed = 0;
  Mask other_mode = 0;
  Mask wrong = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (on && joints_.other_mode(i)) {
      other_mode |= only(i);
    } else if (sweep_.answered() & only(i)) {
      (sweep_.value(i) == on ? confirmed : wrong) |= only(i);
    }
  }
  confirmed &= job_.mask;
  other_mode &= job_.mask;
  // A servo is present but did not get the packet: noise may destroy a packet that has no answer.
  if ((wrong & job_.mask) && try_again()) return begin_again();
  const bool all = (confirmed | other_mode) == job_.mask;
  const uint8_t status = !all ? gen::STATUS_SERVO_SILENT : other_mode ? gen::STATUS_SERVO_FAULT : gen::STATUS_OK;
  if (job_.owner == For::kStop) return finish_stop(status, confirmed);
  reply_torque(on, status, confirmed);
}

void Board::reply_torque(bool on, uint8_t status, Mask confirmed) {
  body()[gen::TORQUE_REPLY_ON] = on ? 1 : 0;
  put16(body() + gen::TORQUE_REPLY_MASK, confirmed);
  reply(status, gen::TORQUE_REPLY_SIZE);
}

void Board::reply_move() {
  const uint8_t* p = now_running_.body;
  uint8_t* out = body();
  uint8_t* row = out + gen::JOINT_MOVE_REPLY_SIZE;
  bool all = true;
  for (uint8_t n = 0; n < p[gen::JOINT_MOVE_REQUEST_COUNT]; ++n) {
    const uint8_t id = p[gen::JOINT_MOVE_REQUEST_SIZE + n * gen::JOINT_MOVE_REQUEST_ROW_SIZE];
    for (uint8_t i = 0; i < kJoints; ++i) {
      if (id != joints_[i].id && id != gen::BROADCAST_ID) continue;
      if (!(job_.targets.mask & only(i))) {
        all = false;
        continue;
      }
      row[gen::JOINT_MOVE_REPLY_ROW_SERVO_ID] = joints_[i].id;
      put16(row + gen::JOINT_MOVE_REPLY_ROW_POSITION, static_cast<uint16_t>(job_.targets.position[i]));
      row[gen::JOINT_MOVE_REPLY_ROW_FLAGS] = joints_[i].clamped ? 1 : 0;
      row += gen::JOINT_MOVE_REPLY_ROW_SIZE;
    }
  }
  const uint8_t size = static_cast<uint8_t>(row - out);
  put16(out + gen::JOINT_MOVE_REPLY_DURATION_MS, job_.duration_ms);
  const uint8_t rows = static_cast<uint8_t>(size - gen::JOINT_MOVE_REPLY_SIZE) / gen::JOINT_MOVE_REPLY_ROW_SIZE;
  out[gen::JOINT_MOVE_REPLY_COUNT] = rows;
  reply(all ? gen::STATUS_OK : gen::STATUS_SERVO_SILENT, size);
}

bool Board::reply_saved() {
  if (settings_.saving() == Saving::kBusy) return false;
  const bool ok = settings_.saving() != Saving::kFailed;
  settings_.forget_result();
  if (!ok) {
    refuse(gen::STATUS_STORAGE);
    return true;
  }
  const Block block = static_cast<Block>(job_.argument);
  const uint8_t size = Settings::rows_size(block);
  body()[gen::LIMITS_REPLY_VERSION] = gen::SETTINGS_VERSION;
  body()[gen::LIMITS_REPLY_JOINTS] = kJoints;
  memcpy(body() + gen::LIMITS_REPLY_SIZE, settings_.rows(block), size);
  reply(gen::STATUS_OK, static_cast<uint8_t>(gen::LIMITS_REPLY_SIZE + size));
  return true;
}

void Board::enter_maintenance() {
  for (uint8_t i = 0; i < kJoints; ++i) {
    if ((sweep_.answered() & only(i)) && sweep_.value(i)) return refuse(gen::STATUS_FORBIDDEN);
  }
  board_flags_ |= gen::BOARD_FLAG_MAINTENANCE;
  reply_maintenance();
}

}  // namespace hexwire
