#include "gate.h"

#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint8_t kMinPacket = 6;
constexpr uint8_t kTorque = gen::HLS_REG_TORQUE_ENABLE;
constexpr uint8_t kTarget = gen::HLS_REG_GOAL_POSITION;
constexpr uint8_t kRunTime = gen::SEVEN_BOT_REG_RUN_TIME;
constexpr uint8_t kLastHalf = gen::HLS_REG_GOAL_SPEED + 1;
constexpr uint8_t kRamEnd = gen::HLS_REG_LOCK - 2;  // last RAM register that is no target, torque or speed
constexpr uint8_t kMoveRow = 4;

static_assert(gen::SEVEN_BOT_REG_TARGET_POSITION == kTarget, "one address for both series");
static_assert(gen::SEVEN_BOT_REG_TORQUE_ENABLE == kTorque, "one address for both series");
static_assert(kRunTime == gen::HLS_REG_GOAL_TORQUE && kRamEnd == gen::HLS_REG_KM, "PROTOCOL.md, section 6.4");

// Whether a sync write has rows, all of them complete, that end at the last register at most.
bool whole_rows(const uint8_t* p, uint8_t parameters) {
  if (parameters <= 2 || p[6] == 0 || p[5] + p[6] > 0x100) return false;
  const uint16_t each = static_cast<uint16_t>(p[6] + 1);
  return (parameters - 2) % each == 0;
}

// Speed, run time or acceleration: they may accompany a target, not stand alone.
bool is_pace(uint8_t address, bool old) {
  if (old) return address == kRunTime || address == kRunTime + 1;
  return address == gen::HLS_REG_ACCELERATION || address == gen::HLS_REG_GOAL_SPEED ||
         address == gen::HLS_REG_GOAL_SPEED + 1;
}

// Registers in RAM that neither move a joint nor are lost with its power.
bool is_ram(uint8_t address, bool old) {
  if (old) return false;
  return address == gen::HLS_REG_GOAL_TORQUE || address == gen::HLS_REG_GOAL_TORQUE + 1 ||
         (address >= gen::HLS_REG_TORQUE_LIMIT && address <= kRamEnd);
}

}  // namespace

bool sound_packet(const uint8_t* p, uint8_t size) {
  return size >= kMinPacket && p[0] == 0xFF && p[1] == 0xFF && p[2] != 0xFF && p[3] + 4 == size &&
         p[size - 1] == servo_checksum(p + 2, static_cast<uint8_t>(size - 3));
}

bool Gate::well_formed(const uint8_t* p, uint8_t size) {
  if (!sound_packet(p, size)) return false;
  const uint8_t parameters = static_cast<uint8_t>(size - kMinPacket);
  switch (p[4]) {
    case gen::INST_READ:
      return parameters == 2 && p[6] != 0 && p[6] + kMinPacket <= kMaxHostAnswer;
    case gen::INST_SYNC_READ:
      if (parameters <= 2 || parameters > 2 + gen::MAX_JOINTS || p[6] == 0) return false;
      return (p[6] + kMinPacket) * (parameters - 2) <= kMaxHostAnswer;
    case gen::INST_WRITE:
      return parameters >= 2 && p[5] + (parameters - 1) <= 0x100;
    case gen::INST_SYNC_WRITE:
      return whole_rows(p, parameters);
    default:
      return true;
  }
}

bool Gate::is_move(const uint8_t* p, uint8_t size) {
  return well_formed(p, size) && p[2] == gen::BROADCAST_ID && p[4] == gen::INST_SYNC_WRITE && p[5] == kTarget &&
         p[6] == kMoveRow;
}

Gate::Row Gate::row_of(uint8_t id, uint8_t address, uint8_t size, const uint8_t* data) const {
  return Row{id, joints_.find(id), address, size, data};
}

Gate::Verdict Gate::judge(const uint8_t* p, uint8_t size, const Circumstances& now) const {
  Verdict verdict = {gen::STATUS_OK, Way::kAsItIs, 0, 0, 0};
  if (is_read(p[4])) return verdict;
  if (now.stopped) {
    verdict.status = gen::STATUS_STOPPED;
    return verdict;
  }
  switch (p[4]) {
    case gen::INST_WRITE:
      verdict.status = judge_row(row_of(p[2], p[5], static_cast<uint8_t>(size - kMinPacket - 1), p + 6), now, &verdict);
      break;
    case gen::INST_SYNC_WRITE:
      for (uint16_t at = 7; at + p[6] + 1U < size; at = static_cast<uint16_t>(at + p[6] + 1)) {
        verdict.status = judge_row(row_of(p[at], p[5], p[6], p + at + 1), now, &verdict);
        if (verdict.status != gen::STATUS_OK) break;
      }
      break;
    case gen::INST_REG_WRITE:
    case gen::INST_ACTION:
      // A stop cannot cancel a write that waits in a servo.
      verdict.status = gen::STATUS_FORBIDDEN;
      break;
    default:
      verdict.status = now.maintenance ? gen::STATUS_OK : gen::STATUS_FORBIDDEN;
      break;
  }
  return verdict;
}

uint8_t Gate::judge_write(uint8_t id, uint8_t address, uint8_t size, const uint8_t* data,
                          const Circumstances& now) const {
  Verdict verdict = {gen::STATUS_OK, Way::kAsItIs, 0, 0, 0};
  return judge_row(row_of(id, address, size, data), now, &verdict);
}

uint8_t Gate::judge_row(const Row& row, const Circumstances& now, Verdict* verdict) const {
  // Half a value cannot be checked.
  for (uint8_t at = kTarget; at < kLastHalf; at = static_cast<uint8_t>(at + 2)) {
    if (row.covers(at) != row.covers(static_cast<uint8_t>(at + 1))) return gen::STATUS_BAD_RANGE;
  }
  for (uint8_t i = 0; i < row.size; ++i) {
    const uint8_t status = judge_register(row, static_cast<uint8_t>(row.address + i), now, verdict);
    if (status != gen::STATUS_OK) return status;
  }
  return gen::STATUS_OK;
}

uint8_t Gate::judge_register(const Row& row, uint8_t address, const Circumstances& now, Verdict* verdict) const {
  switch (address) {
    case kTorque:
      if (*row.at(address) <= 1) return judge_torque(row, *row.at(address), now, verdict);
      return judge_setting(row, address, now);
    case kTarget:
      return judge_target(row, now, verdict);
    case kTarget + 1:
      return gen::STATUS_OK;  // checked with its other half
    default:
      return judge_setting(row, address, now);
  }
}

// A register that neither moves a joint nor gives it torque.
uint8_t Gate::judge_setting(const Row& row, uint8_t address, const Circumstances& now) const {
  const bool joint = row.joint != kNoJoint;
  const bool old = joint && legacy(row.joint);
  if (is_pace(address, old)) return row.covers(kTarget) ? gen::STATUS_OK : gen::STATUS_FORBIDDEN;
  const bool ram = is_ram(address, old);
  if (ram && joint) return gen::STATUS_OK;
  // Settings, and broadcasts.
  return now.maintenance && (!ram || row.id == gen::BROADCAST_ID) ? gen::STATUS_OK : gen::STATUS_FORBIDDEN;
}

uint8_t Gate::judge_torque(const Row& row, uint8_t value, const Circumstances& now, Verdict* verdict) const {
  if (value == 0) return gen::STATUS_OK;
  if (now.maintenance || !now.chapter || row.joint == kNoJoint) return gen::STATUS_FORBIDDEN;
  if (now.busy & only(row.joint)) return gen::STATUS_BUSY;
  const Joint& joint = joints_[row.joint];
  if (verdict->way == Way::kAsItIs) verdict->way = Way::kTorqueOn;
  verdict->mask |= only(row.joint);
  if (joints_.other_mode(row.joint)) return gen::STATUS_SERVO_FAULT;
  if (!joint.present || !joint.known) return gen::STATUS_SERVO_SILENT;
  if (joints_.mode_unknown(row.joint)) verdict->unclear |= only(row.joint);
  return gen::STATUS_OK;
}

uint8_t Gate::judge_target(const Row& row, const Circumstances& now, Verdict* verdict) const {
  if (now.maintenance || row.joint == kNoJoint) return gen::STATUS_FORBIDDEN;
  const Joint& joint = joints_[row.joint];
  const uint8_t* p = row.at(kTarget);
  const int16_t target =
      legacy(row.joint) ? static_cast<int16_t>(get16_big(p)) : decode_signed(get16(p), gen::HLS_REG_GOAL_POSITION_SIGN);
  if (!inside(row.joint, target)) return gen::STATUS_BAD_RANGE;
  if (now.busy & only(row.joint)) return gen::STATUS_BUSY;
  verdict->way = Way::kTargets;
  verdict->mask |= only(row.joint);
  if (joints_.other_mode(row.joint)) return gen::STATUS_SERVO_FAULT;
  if (is_unclear(row.joint, now)) {
    verdict->unclear |= only(row.joint);
    return gen::STATUS_OK;
  }
  if (!now.chapter && !joint.torque_on) return gen::STATUS_TORQUE_OFF;
  return joint.present && joint.known ? gen::STATUS_OK : gen::STATUS_SERVO_SILENT;
}

// Whether something must be read before a target for a joint can be judged.
bool Gate::is_unclear(uint8_t i, const Circumstances& now) const {
  const Joint& joint = joints_[i];
  return joint.present && (joints_.mode_unknown(i) || (!now.chapter && !joint.torque_known));
}

// The chapter's board ignores everything after an unknown id.
Gate::Verdict Gate::judge_move(const uint8_t* p, uint8_t size, const Circumstances& now) const {
  Verdict verdict = {gen::STATUS_OK, Way::kTargets, 0, 0, 0};
  if (now.stopped || now.maintenance) {
    verdict.status = now.stopped ? gen::STATUS_STOPPED : gen::STATUS_FORBIDDEN;
    return verdict;
  }
  for (const uint8_t* at = p + 7; at + kMoveRow + 1 < p + size; at += kMoveRow + 1) {
    const uint8_t i = joints_.find(at[0]);
    if (i == kNoJoint) break;
    verdict.mask |= only(i);
    judge_moved(i, now, &verdict);
  }
  return verdict;
}

void Gate::judge_moved(uint8_t i, const Circumstances& now, Verdict* verdict) const {
  const Joint& joint = joints_[i];
  if (is_unclear(i, now)) verdict->unclear |= only(i);
  if (now.busy & only(i)) verdict->status = gen::STATUS_BUSY;
  if (!joint.present || !joint.known || joints_.other_mode(i)) {
    verdict->silent |= only(i);
  } else if (!now.chapter && joint.torque_known && !joint.torque_on) {
    verdict->status = gen::STATUS_TORQUE_OFF;
  }
}

bool Gate::find_row(const uint8_t* p, uint8_t joint, Row* row) const {
  const uint8_t size = static_cast<uint8_t>(p[3] + 4);
  bool found = false;
  if (p[4] == gen::INST_WRITE) {
    *row = row_of(p[2], p[5], static_cast<uint8_t>(size - kMinPacket - 1), p + 6);
    found = row->joint == joint;
  } else {
    // If a joint is named twice, the later row applies, as in the servo.
    for (uint16_t at = 7; at + p[6] + 1U < size; at = static_cast<uint16_t>(at + p[6] + 1)) {
      if (p[at] != joints_[joint].id) continue;
      *row = row_of(p[at], p[5], p[6], p + at + 1);
      found = true;
    }
  }
  return found && row->covers(kTarget);
}

bool Gate::make_targets(ServoBus& bus, const uint8_t* p, uint8_t series, uint32_t now_ms) const {
  const uint8_t begin = series == gen::SERIES_SEVEN_BOT ? kTarget : gen::HLS_REG_ACCELERATION;
  bool any = false;
  for (uint8_t i = 0; i < kJoints; ++i) {
    Row row;
    if (joints_[i].series != series || !find_row(p, i, &row)) continue;
    if (!any) {
      bus.begin(p[2], p[4]);
      bus.add(begin);
      const uint8_t end = row.covers(gen::HLS_REG_TORQUE_LIMIT) ? static_cast<uint8_t>(row.address + row.size)
                                                                : static_cast<uint8_t>(gen::HLS_REG_TORQUE_LIMIT);
      const uint8_t block = series == gen::SERIES_SEVEN_BOT ? kMoveRow : static_cast<uint8_t>(end - begin);
      if (p[4] == gen::INST_SYNC_WRITE) bus.add(block);
    }
    any = true;
    if (p[4] == gen::INST_SYNC_WRITE) bus.add(row.id);
    add_block(bus, row, now_ms);
  }
  return any;
}

// The complete block of the joint's series, within the speed limit.
void Gate::add_block(ServoBus& bus, const Row& row, uint32_t now_ms) const {
  const uint8_t* position = row.at(kTarget);
  if (legacy(row.joint)) {
    const uint16_t wish = row.covers(kRunTime) ? get16_big(row.at(kRunTime)) : 0;
    const uint32_t duration = at_least(wish, row.joint, static_cast<int16_t>(get16_big(position)), now_ms);
    bus.add(position[0]);
    bus.add(position[1]);
    bus.add16(duration > 0xFFFF ? 0xFFFF : static_cast<uint16_t>(duration), true);
    return;
  }
  const uint16_t limit = fastest(row.joint);
  uint16_t speed = 0;
  if (row.covers(gen::HLS_REG_GOAL_SPEED)) {
    speed = static_cast<uint16_t>(get16(row.at(gen::HLS_REG_GOAL_SPEED)) & (gen::HLS_REG_GOAL_SPEED_SIGN - 1));
  }
  // A gentle ramp also brakes gently: a moving joint would overshoot its limit.
  const bool ramp = row.covers(gen::HLS_REG_ACCELERATION) && !joints_[row.joint].moves;
  bus.add(ramp ? *row.at(gen::HLS_REG_ACCELERATION) : 0);
  bus.add(position[0]);
  bus.add(position[1]);
  const bool ceiling = row.covers(gen::HLS_REG_GOAL_TORQUE);
  bus.add16(ceiling ? get16(row.at(gen::HLS_REG_GOAL_TORQUE)) : joints_[row.joint].ceiling, false);
  bus.add16(speed == 0 || speed > limit ? limit : speed, false);
  for (uint8_t at = gen::HLS_REG_TORQUE_LIMIT; row.covers(at); ++at) bus.add(*row.at(at));
}

void Gate::aim_move(const uint8_t* p, uint8_t size, Mask mask, uint32_t now_ms, Targets* targets) {
  for (const uint8_t* at = p + 7; at + kMoveRow + 1 < p + size; at += kMoveRow + 1) {
    const uint8_t i = joints_.find(at[0]);
    if (i == kNoJoint) break;
    if (!(mask & only(i))) continue;
    const int16_t target = clamp(i, get16(at + 1));
    put_target(targets, i, target, at_least(get16(at + 3), i, target, now_ms));
  }
}

int16_t Gate::clamp(uint8_t joint, int32_t wanted) {
  const int16_t low = settings_.minimum(joint);
  const int16_t high = settings_.maximum(joint);
  const int16_t target = wanted < low ? low : wanted > high ? high : static_cast<int16_t>(wanted);
  joints_[joint].clamped = target != wanted;
  return target;
}

// Usually the duration is long enough. Then there is no division, which on an AVR takes longer than a byte on the line.
uint32_t Gate::at_least(uint32_t duration_ms, uint8_t joint, int16_t target, uint32_t now_ms) const {
  const uint16_t speed = settings_.speed(joint);
  const uint32_t way = static_cast<uint32_t>(joints_.distance(joint, target)) * 1000;
  // A moving joint may be further away than its last sample shows.
  const uint32_t age = joints_[joint].moves ? now_ms - joints_[joint].sampled_ms : 0;
  if (duration_ms >= 0x10000 || (duration_ms >= age && way <= (duration_ms - age) * speed)) return duration_ms;
  return (way + speed - 1) / speed + age;
}

// The speed limit of an HLS joint in its own units. 0 would mean "stop".
uint16_t Gate::fastest(uint8_t joint) const {
  const uint16_t units = static_cast<uint16_t>(settings_.speed(joint) / kHlsSpeedUnit);
  return units ? units : 1;
}

void Gate::put_target(Targets* targets, uint8_t joint, int16_t position, uint32_t duration_ms) const {
  const uint16_t duration = duration_ms > 0xFFFF ? 0xFFFF : static_cast<uint16_t>(duration_ms);
  targets->mask |= only(joint);
  targets->position[joint] = position;
  targets->duration_ms[joint] = duration;
  if (legacy(joint)) return;
  const uint16_t speed = joints_.hls_speed(joint, position, duration);
  const uint16_t limit = fastest(joint);
  targets->speed[joint] = speed > limit ? limit : speed;
}

}  // namespace hexwire
