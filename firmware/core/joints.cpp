#include "hot.h"  // first

#include "joints.h"

#include "bytes.h"

namespace hexwire {

namespace {

const uint8_t kIds[kJoints] = HEXWIRE_JOINT_IDS;
const uint8_t kSeries[kJoints] = HEXWIRE_JOINT_SERIES;

constexpr uint16_t kPollTimeoutUs = 2500;  // five times the longest return delay a servo can be set to
constexpr uint8_t kPollTries = 2;
// An HLS servo takes a speed of 0 as "stop".
constexpr uint16_t kHlsSlowest = 1;
constexpr uint16_t kHlsFastest = 0x7FFF;

constexpr uint8_t kHlsMotionSize = gen::HLS_REG_PRESENT_TEMPERATURE + 1 - gen::HLS_REG_PRESENT_POSITION;

// Place of a register in the parameters of that read.
constexpr uint8_t motion_at(uint8_t address) { return static_cast<uint8_t>(address - gen::HLS_REG_PRESENT_POSITION); }

struct Place {
  uint8_t address;
  uint8_t size;
};

// In the order of the items. One that the series does not have is never asked for.
const Place kLegacyPlaces[] = {
    {gen::SEVEN_BOT_REG_PRESENT_POSITION, 2}, {gen::SEVEN_BOT_REG_TORQUE_ENABLE, 1},
    {gen::SEVEN_BOT_REG_TARGET_POSITION, 2},  {0, 2},
    {gen::SEVEN_BOT_REG_PRESENT_POSITION, 2}, {gen::SEVEN_BOT_REG_PRESENT_VOLTAGE, 2},
    {gen::SEVEN_BOT_REG_PRESENT_CURRENT, 2},  {0, 1},
};
const Place kHlsPlaces[] = {
    {gen::HLS_REG_PRESENT_POSITION, 2}, {gen::HLS_REG_TORQUE_ENABLE, 1},
    {gen::HLS_REG_GOAL_POSITION, 2},    {gen::HLS_REG_GOAL_TORQUE, 2},
    {gen::HLS_REG_PRESENT_POSITION, kHlsMotionSize}, {0, 2},
    {gen::HLS_REG_PRESENT_CURRENT, 2},  {gen::HLS_REG_MODE, 1},
};

bool legacy(uint8_t series) { return series == gen::SERIES_SEVEN_BOT; }

int16_t narrow(int32_t value) {
  return static_cast<int16_t>(value > 32767 ? 32767 : value < -32768 ? -32768 : value);
}

// 6.5 mA per count.
int16_t hls_current(uint16_t raw) {
  return narrow(static_cast<int32_t>(decode_signed(raw, gen::HLS_REG_PRESENT_CURRENT_SIGN)) * 13 / 2);
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

uint8_t Joints::lacking(Item* item) const {
  for (uint8_t i = 0; i < kJoints; ++i) {
    const Joint& joint = joints_[i];
    if (!joint.present) continue;
    *item = !joint.torque_known ? Item::kTorque : !joint.ceiling_known ? Item::kCeiling : Item::kMode;
    const bool known = joint.torque_known && (legacy(joint.series) || (joint.ceiling_known && joint.mode_known));
    if (!known) return i;
  }
  return kNoJoint;
}

bool Joints::is_lacking() const {
  Item item;
  return lacking(&item) != kNoJoint;
}

bool Joints::has(uint8_t joint, Item item) const {
  if (item == Item::kCeiling || item == Item::kMode) return !legacy(joints_[joint].series);
  return item != Item::kSupply || legacy(joints_[joint].series);
}

// Address and size of an item's register.
void Joints::locate(uint8_t joint, Item item, uint8_t* address, uint8_t* size) const {
  const Place* places = legacy(joints_[joint].series) ? kLegacyPlaces : kHlsPlaces;
  const Place& place = places[static_cast<uint8_t>(item)];
  *address = place.address;
  *size = place.size;
}

void Joints::store_position(Joint& joint, uint16_t raw, uint32_t now_us, uint32_t now_ms) {
  const bool old = legacy(joint.series);
  const int16_t position = decode_signed(raw, old ? 0 : gen::HLS_REG_PRESENT_POSITION_SIGN);
  const uint32_t ticks = (now_us - joint.sampled_us) / 64;
  if (old && joint.known && ticks) {
    // These servos report no speed: it is computed from the previous sample, in ticks of 64 us so that 32 bits
    // suffice.
    const int32_t way = static_cast<int32_t>(position) - joint.position;
    joint.speed = way ? narrow(way * 15625 / static_cast<int32_t>(ticks)) : 0;
  }
  joint.moves = joint.known && position != joint.position;
  joint.position = position;
  joint.sampled_us = now_us;
  joint.sampled_ms = now_ms;
  joint.known = true;
}

int16_t Joints::store(uint8_t index, Item item, const uint8_t* p, uint8_t error, uint32_t now_us, uint32_t now_ms) {
  Joint& joint = joints_[index];
  const bool old = legacy(joint.series);
  joint.error = error;
  joint.present = true;
  const uint16_t raw = old ? get16_big(p) : get16(p);
  if (item != Item::kPosition && item != Item::kMotion) return store_other(joint, item, p, raw);
  if (item == Item::kMotion && !old) store_motion(joint, p);
  store_position(joint, raw, now_us, now_ms);
  return joint.position;
}

int16_t Joints::store_other(Joint& joint, Item item, const uint8_t* p, uint16_t raw) {
  const bool old = legacy(joint.series);
  switch (item) {
    case Item::kTorque:
      joint.torque_on = p[0] == 1;
      joint.torque_known = true;
      return p[0];
    case Item::kTarget:
      return decode_signed(raw, old ? 0 : gen::HLS_REG_GOAL_POSITION_SIGN);
    case Item::kCeiling:
      // With a ceiling of 0 the joint could not move at all.
      joint.ceiling = raw ? raw : gen::DEFAULT_CEILING;
      joint.ceiling_known = true;
      return static_cast<int16_t>(raw);
    case Item::kMode:
      joint.in_position = p[0] == 0;
      joint.mode_known = true;
      return p[0];
    case Item::kSupply:
      joint.voltage = p[0];
      joint.temperature = static_cast<int8_t>(p[1]);
      return 0;
    default:  // kCurrent
      joint.current = old ? narrow(raw) : hls_current(raw);
      return joint.current;
  }
}

// Stores what an HLS servo gives besides its position.
void Joints::store_motion(Joint& joint, const uint8_t* p) {
  const uint16_t speed = get16(p + motion_at(gen::HLS_REG_PRESENT_SPEED));
  const int16_t units = decode_signed(speed, gen::HLS_REG_PRESENT_SPEED_SIGN);
  joint.speed = narrow(static_cast<int32_t>(units) * kHlsSpeedUnit);
  joint.load = decode_signed(get16(p + motion_at(gen::HLS_REG_PRESENT_LOAD)), gen::HLS_REG_PRESENT_LOAD_SIGN);
  joint.voltage = p[motion_at(gen::HLS_REG_PRESENT_VOLTAGE)];
  joint.temperature = static_cast<int8_t>(p[motion_at(gen::HLS_REG_PRESENT_TEMPERATURE)]);
}

void Joints::missed(uint8_t index) {
  Joint& joint = joints_[index];
  joint.present = joint.torque_known = joint.ceiling_known = joint.mode_known = false;
  joint.sync_misses = 0;
}

void Joints::try_sync_again() {
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!syncs(i)) --joints_[i].sync_misses;
  }
}

void Joints::forget_settings() {
  for (uint8_t i = 0; i < kJoints; ++i) {
    joints_[i].torque_known = joints_[i].ceiling_known = joints_[i].mode_known = false;
  }
}

uint8_t Joints::make_read(ServoBus& bus, uint8_t joint, Item item) const {
  uint8_t address;
  uint8_t size;
  locate(joint, item, &address, &size);
  bus.begin(joints_[joint].id, gen::INST_READ);
  bus.add(address);
  bus.add(size);
  return size;
}

uint8_t Joints::make_sync_read(ServoBus& bus, const uint8_t* joints, uint8_t count, Item item) const {
  uint8_t address;
  uint8_t size;
  locate(joints[0], item, &address, &size);
  bus.begin(gen::BROADCAST_ID, gen::INST_SYNC_READ);
  bus.add(address);
  bus.add(size);
  for (uint8_t i = 0; i < count; ++i) bus.add(joints_[joints[i]].id);
  return size;
}

uint16_t Joints::distance(uint8_t joint, int16_t target) const {
  const int32_t difference = static_cast<int32_t>(target) - joints_[joint].position;
  return static_cast<uint16_t>(difference < 0 ? -difference : difference);
}

uint16_t Joints::hls_speed(uint8_t joint, int16_t target, uint16_t duration_ms) const {
  const uint32_t way = static_cast<uint32_t>(distance(joint, target)) * 1000;
  const uint32_t unit = static_cast<uint32_t>(duration_ms) * kHlsSpeedUnit;
  if (way == 0) return kHlsSlowest;
  if (unit == 0) return kHlsFastest;
  const uint32_t speed = (way + unit - 1) / unit;
  return speed > kHlsFastest ? kHlsFastest : static_cast<uint16_t>(speed);
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
    bus.add(0);
    bus.add16(encode_signed(targets.position[i], gen::HLS_REG_GOAL_POSITION_SIGN), false);
    bus.add16(joints_[i].ceiling, false);
    bus.add16(targets.speed[i], false);
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

Sweep::Sweep(ServoBus& bus, Joints& joints, Raw* raw)
    : bus_(bus),
      joints_(joints),
      item_(Item::kPosition),
      taken_item_(Item::kPosition),
      order_(),
      next_(0),
      count_(0),
      many_(),
      many_count_(0),
      many_asked_(false),
      last_(kNoJoint),
      answered_(0),
      undigested_(0),
      taken_us_(0),
      taken_ms_(0),
      raw_(raw),
      values_() {}

void Sweep::begin(Mask mask, Item item, bool use_sync_read) {
  digest();
  last_ = kNoJoint;
  item_ = item;
  answered_ = 0;
  next_ = count_ = many_count_ = 0;
  many_asked_ = false;
  for (uint8_t i = 0; i < kJoints; ++i, mask >>= 1) {
    if (!(mask & 1) || !joints_.has(i, item)) continue;
    if (use_sync_read && joints_[i].series == gen::SERIES_HLS && joints_.syncs(i)) {
      many_[many_count_++] = i;
    } else {
      order_[count_++] = i;
    }
  }
  if (many_count_ == 1) {
    // A sync read of one costs more than a read.
    order_[count_++] = many_[0];
    many_count_ = 0;
  }
}

bool Sweep::start_next(uint32_t now_ms) {
  if (many_count_) {
    make_many(now_ms);
    many_asked_ = true;
    return true;
  }
  if (next_ == count_) return false;
  make_single(order_[next_], now_ms);
  return true;
}

bool Sweep::prepare(uint32_t now_ms, bool own) {
  if (many_count_ && !many_asked_) {
    make_many(now_ms);
    return true;
  }
  // Of its own, the transaction that runs may be a sync read, or of the sweep before.
  const uint8_t next = own && !many_asked_ && last_ == kNoJoint ? static_cast<uint8_t>(next_ + 1) : next_;
  if (next >= count_) return false;
  make_single(order_[next], now_ms);
  return true;
}

bool Sweep::at_last() const { return !many_asked_ && many_count_ == 0 && last_ == kNoJoint && next_ + 1 == count_; }

void Sweep::begin_after(Mask mask, Item item, bool use_sync_read) {
  const uint8_t last = order_[next_];
  const Item taken = item_;
  begin(mask, item, use_sync_read);
  last_ = last;
  taken_item_ = taken;
}

void Sweep::make_single(uint8_t joint, uint32_t now_ms) {
  Joint& asked = joints_[joint];
  asked.asked_ms = now_ms;
  const uint8_t size = joints_.make_read(bus_, joint, item_);
  const uint8_t header = legacy(asked.series) ? 0xF5 : 0xFF;
  bus_.start_single(Expect{header, size, false, kPollTries, kPollTimeoutUs});
}

void Sweep::make_many(uint32_t now_ms) {
  for (uint8_t i = 0; i < many_count_; ++i) joints_[many_[i]].asked_ms = now_ms;
  const uint8_t size = joints_.make_sync_read(bus_, many_, many_count_, item_);
  bus_.start_many(many_count_, Expect{0xFF, size, false, 1, kPollTimeoutUs});
}

void Sweep::take_one(uint8_t joint, const uint8_t* packet) {
  Raw& raw = raw_[undigested_++];
  raw.joint = joint;
  raw.size = 0;
  if (packet == nullptr) return;
  raw.error = packet[4];
  raw.size = static_cast<uint8_t>(packet[3] - 2);
  for (uint8_t i = 0; i < raw.size && i < kLongestItem; ++i) raw.data[i] = packet[5 + i];
}

void Sweep::take_result(uint32_t now_us, uint32_t now_ms) {
  if (undigested_) digest();
  taken_us_ = now_us;
  taken_ms_ = now_ms;
  if (last_ != kNoJoint) {
    take_one(last_, bus_.answer());
    last_ = kNoJoint;
    return;
  }
  taken_item_ = item_;
  if (many_asked_) {
    take_many();
  } else {
    take_one(order_[next_++], bus_.answer());
  }
}

void Sweep::take_many() {
  for (uint8_t i = 0; i < many_count_; ++i) {
    const uint8_t* packet = bus_.answer(i);
    if (packet != nullptr) {
      joints_[many_[i]].sync_misses = 0;
      take_one(many_[i], packet);
    } else {
      // A servo that is missing is asked once more, alone.
      joints_.missed_sync(many_[i]);
      order_[count_++] = many_[i];
    }
  }
  many_count_ = 0;
  many_asked_ = false;
}

void Sweep::digest() {
  for (uint8_t i = 0; i < undigested_; ++i) {
    const Raw& raw = raw_[i];
    if (raw.size) {
      values_[raw.joint] = joints_.store(raw.joint, taken_item_, raw.data, raw.error, taken_us_, taken_ms_);
      answered_ |= only(raw.joint);
    } else if (taken_item_ == Item::kPosition || taken_item_ == Item::kMotion) {
      // Only a missing position means absence: not every servo has every register.
      joints_.missed(raw.joint);
    }
  }
  undigested_ = 0;
}

}  // namespace hexwire
