#include "joints.h"

#include "bytes.h"

namespace hexwire {

namespace {

const uint8_t kIds[kJoints] = HEXWIRE_JOINT_IDS;
const uint8_t kSeries[kJoints] = HEXWIRE_JOINT_SERIES;

constexpr uint16_t kPollTimeoutUs = 2500;  // five times the longest return delay a servo can be set to
constexpr uint8_t kPollTries = 2;
constexpr uint16_t kHlsSpeedUnit = 50;     // counts/s
// 0 on the way down means "stop" to an HLS servo.
constexpr uint16_t kHlsSlowest = 1;
constexpr uint16_t kHlsFastest = 0x7FFF;

constexpr uint8_t kHlsMotionSize = gen::HLS_REG_PRESENT_TEMPERATURE + 1 - gen::HLS_REG_PRESENT_SPEED;

bool legacy(uint8_t series) { return series == gen::SERIES_SEVEN_BOT; }

int16_t narrow(int32_t value) {
  return static_cast<int16_t>(value > 32767 ? 32767 : value < -32768 ? -32768 : value);
}

}  // namespace

Joints::Joints() : joints_() {
  for (uint8_t i = 0; i < kJoints; ++i) {
    joints_[i].id = kIds[i];
    joints_[i].series = kSeries[i];
  }
}

uint8_t Joints::find(uint8_t servo_id) const {
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (joints_[i].id == servo_id) return i;
  }
  return kNoJoint;
}

Mask Joints::with_series(uint8_t series) const {
  Mask mask = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (joints_[i].series == series) mask |= only(i);
  }
  return mask;
}

Mask Joints::present() const {
  Mask mask = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (joints_[i].present) mask |= only(i);
  }
  return mask;
}

bool Joints::locate(uint8_t joint, Item item, uint8_t* address, uint8_t* size) const {
  const bool old = legacy(joints_[joint].series);
  *size = 2;
  switch (item) {
    case Item::kPosition:
      *address = old ? gen::SEVEN_BOT_REG_PRESENT_POSITION : gen::HLS_REG_PRESENT_POSITION;
      return true;
    case Item::kTorque:
      *address = old ? gen::SEVEN_BOT_REG_TORQUE_ENABLE : gen::HLS_REG_TORQUE_ENABLE;
      *size = 1;
      return true;
    case Item::kTarget:
      *address = old ? gen::SEVEN_BOT_REG_TARGET_POSITION : gen::HLS_REG_GOAL_POSITION;
      return true;
    case Item::kCeiling:
      *address = gen::HLS_REG_GOAL_TORQUE;
      return !old;
    case Item::kMotion:
      *address = gen::HLS_REG_PRESENT_SPEED;
      *size = kHlsMotionSize;
      return !old;
    case Item::kSupply:
      *address = gen::SEVEN_BOT_REG_PRESENT_VOLTAGE;
      return old;
    case Item::kCurrent:
      *address = old ? gen::SEVEN_BOT_REG_PRESENT_CURRENT : gen::HLS_REG_PRESENT_CURRENT;
      return true;
  }
  return false;
}

int16_t Joints::store(uint8_t index, Item item, const uint8_t* p, uint8_t error, uint32_t now_us, uint32_t now_ms) {
  Joint& joint = joints_[index];
  const bool old = legacy(joint.series);
  joint.error = error;
  joint.present = true;
  const uint16_t raw = old ? get16_big(p) : get16(p);
  switch (item) {
    case Item::kPosition: {
      const int16_t position = decode_signed(raw, old ? 0 : gen::HLS_REG_PRESENT_POSITION_SIGN);
      const uint32_t ticks = (now_us - joint.sampled_us) / 64;
      if (old && joint.known && ticks) {
        // These servos report no speed: it is the difference to the sample before, in 64 us ticks to stay in 32 bits.
        joint.speed = narrow((static_cast<int32_t>(position) - joint.position) * 15625 / static_cast<int32_t>(ticks));
      }
      joint.position = position;
      joint.sampled_us = now_us;
      joint.known = true;
      joint.sampled_ms = now_ms;
      return position;
    }
    case Item::kTorque:
      joint.torque_on = p[0] == 1;
      return p[0];
    case Item::kTarget:
      return decode_signed(raw, old ? 0 : gen::HLS_REG_GOAL_POSITION_SIGN);
    case Item::kCeiling:
      // 0 would mean that the joint cannot move at all.
      joint.ceiling = raw ? raw : gen::DEFAULT_CEILING;
      joint.ceiling_known = true;
      return static_cast<int16_t>(raw);
    case Item::kMotion:
      joint.speed = narrow(static_cast<int32_t>(decode_signed(raw, gen::HLS_REG_PRESENT_SPEED_SIGN)) * kHlsSpeedUnit);
      joint.load = decode_signed(get16(p + gen::HLS_REG_PRESENT_LOAD - gen::HLS_REG_PRESENT_SPEED),
                                 gen::HLS_REG_PRESENT_LOAD_SIGN);
      joint.voltage = p[gen::HLS_REG_PRESENT_VOLTAGE - gen::HLS_REG_PRESENT_SPEED];
      joint.temperature = static_cast<int8_t>(p[gen::HLS_REG_PRESENT_TEMPERATURE - gen::HLS_REG_PRESENT_SPEED]);
      return joint.speed;
    case Item::kSupply:
      joint.voltage = p[0];
      joint.temperature = static_cast<int8_t>(p[1]);
      return 0;
    case Item::kCurrent:
      if (old) {
        joint.current = narrow(raw);
      } else {
        // 6.5 mA a count.
        joint.current = narrow(static_cast<int32_t>(decode_signed(raw, gen::HLS_REG_PRESENT_CURRENT_SIGN)) * 13 / 2);
      }
      return joint.current;
  }
  return 0;
}

void Joints::missed(uint8_t joint) { joints_[joint].present = false; }

bool Joints::make_read(ServoBus& bus, uint8_t joint, Item item) const {
  uint8_t address;
  uint8_t size;
  if (!locate(joint, item, &address, &size)) return false;
  bus.begin(joints_[joint].id, gen::INST_READ);
  bus.add(address);
  bus.add(size);
  return true;
}

bool Joints::make_sync_read(ServoBus& bus, Mask mask, Item item) const {
  uint8_t address = 0;
  uint8_t size = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (mask & only(i)) locate(i, item, &address, &size);
  }
  bus.begin(gen::BROADCAST_ID, gen::INST_SYNC_READ);
  bus.add(address);
  bus.add(size);
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (mask & only(i)) bus.add(joints_[i].id);
  }
  return true;
}

uint16_t Joints::distance(uint8_t joint, int16_t target) const {
  const int32_t difference = static_cast<int32_t>(target) - joints_[joint].position;
  return static_cast<uint16_t>(difference < 0 ? -difference : difference);
}

bool Joints::make_targets(ServoBus& bus, const Targets& targets, uint8_t series) const {
  const Mask mask = targets.mask & with_series(series);
  if (!mask) return false;
  const bool old = legacy(series);
  bus.begin(gen::BROADCAST_ID, gen::INST_SYNC_WRITE);
  bus.add(old ? gen::SEVEN_BOT_REG_TARGET_POSITION : gen::HLS_REG_ACCELERATION);
  bus.add(old ? 4 : 7);
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(mask & only(i))) continue;
    bus.add(joints_[i].id);
    if (old) {
      bus.add16(static_cast<uint16_t>(targets.position[i]), true);
      bus.add16(targets.duration_ms[i], true);
      continue;
    }
    const uint32_t unit = static_cast<uint32_t>(targets.duration_ms[i]) * kHlsSpeedUnit;
    const uint32_t way = static_cast<uint32_t>(distance(i, targets.position[i])) * 1000;
    uint32_t speed = unit ? (way + unit - 1) / unit : kHlsFastest;
    if (speed < kHlsSlowest || way == 0) speed = kHlsSlowest;
    if (speed > kHlsFastest) speed = kHlsFastest;
    bus.add(0);
    bus.add16(encode_signed(targets.position[i], gen::HLS_REG_GOAL_POSITION_SIGN), false);
    bus.add16(joints_[i].ceiling, false);
    bus.add16(static_cast<uint16_t>(speed), false);
  }
  return true;
}

bool Joints::make_torque(ServoBus& bus, Mask mask, bool on) const {
  if (!mask) return false;
  static_assert(gen::SEVEN_BOT_REG_TORQUE_ENABLE == gen::HLS_REG_TORQUE_ENABLE, "one sync write serves both series");
  bus.begin(gen::BROADCAST_ID, gen::INST_SYNC_WRITE);
  bus.add(gen::HLS_REG_TORQUE_ENABLE);
  bus.add(1);
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(mask & only(i))) continue;
    bus.add(joints_[i].id);
    bus.add(on ? 1 : 0);
  }
  return true;
}

Sweep::Sweep(ServoBus& bus, Joints& joints)
    : bus_(bus),
      joints_(joints),
      item_(Item::kPosition),
      use_sync_read_(false),
      todo_(0),
      asked_(0),
      answered_(0),
      values_() {}

void Sweep::begin(Mask mask, Item item, bool use_sync_read) {
  item_ = item;
  use_sync_read_ = use_sync_read;
  todo_ = mask;
  answered_ = 0;
}

bool Sweep::start_next(uint32_t now_ms) {
  uint8_t address;
  uint8_t size;
  Expect expect = {kAnyHeader, 0, false, kPollTries, kPollTimeoutUs};
  const Mask able = use_sync_read_ ? static_cast<Mask>(todo_ & joints_.with_series(gen::SERIES_HLS)) : 0;
  if (able & (able - 1)) {
    // Two or more. Those that stay silent are asked again one by one.
    use_sync_read_ = false;
    asked_ = able;
    uint8_t ids[kJoints];
    uint8_t count = 0;
    for (uint8_t i = 0; i < kJoints; ++i) {
      if (!(able & only(i))) continue;
      joints_.locate(i, item_, &address, &size);
      joints_[i].asked_ms = now_ms;
      ids[count++] = joints_[i].id;
    }
    joints_.make_sync_read(bus_, able, item_);
    expect.header = 0xFF;
    expect.parameters = size;
    expect.tries = 1;
    bus_.start_many(ids, count, expect);
    return true;
  }
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(todo_ & only(i))) continue;
    if (!joints_.locate(i, item_, &address, &size)) {
      todo_ &= static_cast<Mask>(~only(i));
      continue;
    }
    asked_ = only(i);
    joints_[i].asked_ms = now_ms;
    joints_.make_read(bus_, i, item_);
    expect.header = legacy(joints_[i].series) ? 0xF5 : 0xFF;
    expect.parameters = size;
    bus_.start_single(expect);
    return true;
  }
  return false;
}

void Sweep::take_one(uint8_t joint, uint8_t index, uint32_t now_us, uint32_t now_ms) {
  const uint8_t* packet = bus_.answer(index);
  if (packet == nullptr) return;
  values_[joint] = joints_.store(joint, item_, packet + 5, packet[4], now_us, now_ms);
  answered_ |= only(joint);
  todo_ &= static_cast<Mask>(~only(joint));
}

void Sweep::take_result(uint32_t now_us, uint32_t now_ms) {
  uint8_t index = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (asked_ & only(i)) take_one(i, index++, now_us, now_ms);
  }
  if (!(asked_ & (asked_ - 1)) && !(asked_ & answered_)) {
    // A single read, already repeated. Only the position tells presence: not every servo has every register.
    for (uint8_t i = 0; i < kJoints; ++i) {
      if ((asked_ & only(i)) && item_ == Item::kPosition) joints_.missed(i);
    }
    todo_ &= static_cast<Mask>(~asked_);
  }
}

}  // namespace hexwire
