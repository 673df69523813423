#include "servo_model.h"

#include <string.h>

#include <algorithm>
#include <cmath>

#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint8_t kGoal = gen::HLS_REG_GOAL_POSITION;
constexpr uint8_t kTorque = gen::HLS_REG_TORQUE_ENABLE;
constexpr double kFastest = 20000;  // counts/s: faster than any real servo, so that excess speed shows

// Servos ignore what is not a whole packet.
bool is_whole(const std::vector<uint8_t>& p) {
  const size_t size = p.size();
  return size >= 6 && p[0] == 0xFF && p[1] == 0xFF && p[3] + 4u == size &&
         p[size - 1] == servo_checksum(&p[2], static_cast<uint8_t>(size - 3));
}

}  // namespace

ServoModel::ServoModel(uint8_t id, bool is_legacy, int16_t at)
    : legacy(is_legacy), silent(false), position(at), speed(0), registers() {
  registers[gen::HLS_REG_ID] = id;
  registers[gen::HLS_REG_LOCK] = 1;
  if (!legacy) put_word(gen::HLS_REG_GOAL_TORQUE, 300);
  put_word(kGoal, static_cast<uint16_t>(at));
}

uint16_t ServoModel::word(uint8_t address) const {
  return legacy ? get16_big(registers + address) : get16(registers + address);
}

void ServoModel::put_word(uint8_t address, uint16_t value) {
  legacy ? put16_big(registers + address, value) : put16(registers + address, value);
}

int16_t ServoModel::goal() const {
  return decode_signed(word(kGoal), legacy ? 0 : gen::HLS_REG_GOAL_POSITION_SIGN);
}

void ServoModel::step(uint32_t us) {
  if (!torque_on()) return;
  const double seconds = us * 1e-6;
  if (mode() == 1) {
    position += decode_signed(word(gen::HLS_REG_GOAL_SPEED), gen::HLS_REG_GOAL_SPEED_SIGN) * 50 * seconds;
  } else if (mode() > 1) {
    position += decode_signed(word(gen::HLS_REG_GOAL_TORQUE), gen::HLS_REG_GOAL_TORQUE_SIGN) * seconds;
  } else {
    const double way = goal() - position;
    const double most = speed * seconds;
    position += std::max(-most, std::min(most, way));
  }
}

bool ServoModel::is_addressed(uint8_t to) const {
  if (silent) return false;
  if (to == gen::BROADCAST_ID || to == id()) return true;
  return !legacy && to != 0 && to == registers[gen::HLS_REG_SECONDARY_ID];
}

std::vector<uint8_t> ServoModel::status(const std::vector<uint8_t>& parameters) const {
  std::vector<uint8_t> p = {0xFF, static_cast<uint8_t>(legacy ? 0xF5 : 0xFF), id(),
                            static_cast<uint8_t>(parameters.size() + 2), 0};
  p.insert(p.end(), parameters.begin(), parameters.end());
  p.push_back(servo_checksum(&p[2], static_cast<uint8_t>(p.size() - 2)));
  return p;
}

bool ServoModel::read(uint8_t address, uint8_t count, std::vector<uint8_t>* answer) {
  if (count == 0 || address + count > 256 || (legacy && count > 2)) return false;
  // The register has 16 bits, but the shaft may turn without end.
  const int32_t shown = static_cast<int32_t>(std::lround(std::fmod(position, 30000)));
  const uint16_t raw = legacy ? static_cast<uint16_t>(std::max(0, std::min(4095, shown)))
                              : encode_signed(static_cast<int16_t>(shown), gen::HLS_REG_PRESENT_POSITION_SIGN);
  put_word(gen::HLS_REG_PRESENT_POSITION, raw);
  *answer = status(std::vector<uint8_t>(registers + address, registers + address + count));
  return true;
}

void ServoModel::write(uint8_t address, const uint8_t* data, uint8_t count) {
  const uint8_t torque = registers[kTorque];
  for (uint16_t i = 0; i < count && address + i < 256; ++i) registers[address + i] = data[i];
  if (torque != 1 && torque_on()) {
    // It holds its position and forgets an old goal.
    speed = 0;
    if (!(address <= kGoal && kGoal < address + count)) put_word(kGoal, static_cast<uint16_t>(std::lround(position)));
  }
  if (!(address <= kGoal + 1 && kGoal < address + count)) return;
  registers[kTorque] = 1;
  const double way = std::fabs(goal() - position);
  if (legacy) {
    const uint16_t run_time = word(gen::SEVEN_BOT_REG_RUN_TIME);
    speed = run_time ? std::min(kFastest, way * 1000 / run_time) : kFastest;
  } else {
    const uint16_t units = word(gen::HLS_REG_GOAL_SPEED) & (gen::HLS_REG_GOAL_SPEED_SIGN - 1);
    speed = units ? std::min<double>(kFastest, units * 50.0) : kFastest;
  }
}

ServoLine::ServoLine(ServoWatcher& watcher, const std::vector<ServoModel>& all) : servos(all), watcher_(watcher) {}

void ServoLine::step(uint32_t us) {
  for (ServoModel& servo : servos) servo.step(us);
}

void ServoLine::write(ServoModel& servo, uint8_t address, const uint8_t* data, uint8_t count) {
  const ServoModel before = servo;
  servo.write(address, data, count);
  watcher_.written(before, servo, address <= kGoal + 1 && kGoal < address + count);
}

std::vector<uint8_t> ServoLine::exchange(const std::vector<uint8_t>& p) {
  std::vector<uint8_t> heard;
  if (!is_whole(p)) return heard;
  const Packet packet = {p[2], p[4], &p[5], static_cast<uint8_t>(p.size() - 6)};
  if (packet.instruction == gen::INST_SYNC_READ) return sync_read(packet);
  for (ServoModel& servo : servos) {
    if (!servo.is_addressed(packet.id)) continue;
    const std::vector<uint8_t> answer = obey(servo, packet);
    heard.insert(heard.end(), answer.begin(), answer.end());
  }
  return heard;
}

std::vector<uint8_t> ServoLine::obey(ServoModel& servo, const Packet& p) {
  std::vector<uint8_t> answer;
  const bool own = p.id == servo.id();
  switch (p.instruction) {
    case gen::INST_PING:
      if (own) answer = servo.status({});
      break;
    case gen::INST_READ:
      if (own && p.count == 2) servo.read(p.parameters[0], p.parameters[1], &answer);
      break;
    case gen::INST_SYNC_WRITE:
      sync_write(servo, p);
      break;
    case gen::INST_WRITE:
    case gen::INST_REG_WRITE:
    case gen::INST_ACTION:
      if (own && !servo.legacy) answer = servo.status({});
      take(servo, p);
      break;
    default:
      reset(servo, p.instruction);
      break;
  }
  return answer;
}

// What a servo does with a packet that writes to it.
void ServoLine::take(ServoModel& servo, const Packet& p) {
  if (p.instruction == gen::INST_ACTION) {
    const std::vector<uint8_t> waited = servo.waiting;
    servo.waiting.clear();
    if (!waited.empty()) write(servo, waited[0], &waited[1], static_cast<uint8_t>(waited.size() - 1));
    return;
  }
  if (p.count < 2) return;
  if (p.instruction == gen::INST_WRITE) return write(servo, p.parameters[0], p.parameters + 1, static_cast<uint8_t>(p.count - 1));
  servo.waiting.assign(p.parameters, p.parameters + p.count);
}

void ServoLine::sync_write(ServoModel& servo, const Packet& p) {
  if (p.id != gen::BROADCAST_ID || p.count < 3 || p.parameters[1] == 0) return;
  const uint8_t each = p.parameters[1];
  for (size_t at = 2; at + each < p.count; at += each + 1u) {
    if (p.parameters[at] == servo.id()) write(servo, p.parameters[0], p.parameters + at + 1, each);
  }
}

// Resets and the like: torque is lost, the id stays.
void ServoLine::reset(ServoModel& servo, uint8_t instruction) {
  const ServoModel before = servo;
  servo.registers[kTorque] = 0;
  if (instruction == gen::INST_RESTORE && !servo.legacy) servo.registers[gen::HLS_REG_MODE] = 0;
  watcher_.written(before, servo, false);
}

std::vector<uint8_t> ServoLine::sync_read(const Packet& p) {
  std::vector<uint8_t> heard;
  if (p.id != gen::BROADCAST_ID || p.count <= 2) return heard;
  for (uint8_t i = 2; i < p.count; ++i) {
    for (ServoModel& servo : servos) {
      std::vector<uint8_t> answer;
      if (servo.legacy || servo.silent || servo.id() != p.parameters[i]) continue;
      if (servo.read(p.parameters[0], p.parameters[1], &answer)) heard.insert(heard.end(), answer.begin(), answer.end());
    }
  }
  return heard;
}

}  // namespace hexwire
