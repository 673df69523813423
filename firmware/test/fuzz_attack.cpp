#include "fuzz_attack.h"

#include <algorithm>

#include "bytes.h"

namespace hexwire {

namespace {

uint8_t low(uint32_t value) { return static_cast<uint8_t>(value); }
uint8_t high(uint32_t value) { return static_cast<uint8_t>(value >> 8); }

}  // namespace

const Attack::Action Attack::kActions[16] = {
    &Attack::any_command, &Attack::any_packet,  &Attack::write,  &Attack::sync_write, &Attack::move,  &Attack::torque,
    &Attack::stop,        &Attack::resume,      &Attack::watchdog, &Attack::maintenance, &Attack::limits, &Attack::noise,
    &Attack::servo_noise, &Attack::again,       &Attack::silence, &Attack::longer};

void Attack::run() {
  for (int actions = 0; in_.size > 0 && actions < 120; ++actions) {
    const uint8_t what = in_.byte();
    (this->*kActions[what & 0x0F])();
    w_.run(kStepUs * ((what >> 4) * (what >> 4) * (what >> 4) + 1u));
  }
}

void Attack::ask(uint8_t cmd, const std::vector<uint8_t>& body) {
  w_.put_frame(gen::PROTO_HEXWIRE, cmd, body, w_.next_seq());
}

// Sends a packet by one of the commands that carry packets.
void Attack::pass(const std::vector<uint8_t>& packet, uint8_t way) {
  const uint8_t proto = w_.dialect_1() && way & 4 ? gen::PROTO_CHAPTER : gen::PROTO_HEXWIRE;
  const uint8_t cmds[] = {gen::CMD_TRANSACT, gen::CMD_READ, gen::CMD_SYNC_WRITE, gen::CMD_PING};
  const uint8_t cmd = cmds[way & 3];
  std::vector<uint8_t> body;
  if (cmd == gen::CMD_TRANSACT && proto == gen::PROTO_HEXWIRE) body = {static_cast<uint8_t>(way & 8 ? 6 : 0), 0};
  body.insert(body.end(), packet.begin(), packet.end());
  w_.put_frame(proto, proto == gen::PROTO_CHAPTER && cmd == gen::CMD_TRANSACT ? gen::CMD_READ : cmd, body, w_.next_seq());
}

// Any command, any body.
void Attack::any_command() {
  const uint8_t cmd = kCommands[in_.byte() % sizeof(kCommands)];
  ask(cmd, in_.bytes(in_.byte()));
}

// Any packet to any servo.
void Attack::any_packet() {
  const uint8_t way = in_.byte();
  const uint8_t id = in_.byte();
  const uint8_t instruction = kInstructions[in_.byte() & 15];
  pass(servo_packet(id, instruction, in_.bytes(in_.byte() % 200)), way);
}

// A plausible write.
void Attack::write() {
  const uint8_t way = in_.byte();
  const uint8_t id = in_.byte() % 9;
  const uint8_t address = in_.byte() % 64;
  std::vector<uint8_t> parameters = in_.bytes(in_.byte() % 12);
  parameters.insert(parameters.begin(), address);
  pass(servo_packet(id == 8 ? gen::BROADCAST_ID : id, gen::INST_WRITE, parameters), way);
}

// A plausible sync write.
void Attack::sync_write() {
  const uint8_t way = in_.byte();
  const uint8_t address = in_.byte() % 64;
  const uint8_t each = in_.byte() % 10;
  std::vector<uint8_t> parameters = {address, each};
  for (uint8_t rows = in_.byte() % 12; rows; --rows) {
    parameters.push_back(in_.byte() % 9);
    for (uint8_t i = 0; i < each; ++i) parameters.push_back(in_.byte());
  }
  pass(servo_packet(gen::BROADCAST_ID, gen::INST_SYNC_WRITE, parameters), way);
}

void Attack::move() {
  const uint16_t duration = in_.word();
  const uint8_t mask = in_.byte();
  std::vector<uint8_t> body = {low(duration), high(duration), 0};
  for (uint8_t i = 0; i < gen::JOINTS; ++i) {
    if (!(mask & (1u << i))) continue;
    const uint16_t target = in_.word();
    body.insert(body.end(), {i, low(target), static_cast<uint8_t>(target >> 8 & 0x1F)});
    ++body[2];
  }
  ask(gen::CMD_JOINT_MOVE, body);
}

void Attack::torque() {
  const uint8_t mask = in_.byte();
  ask(gen::CMD_TORQUE, {static_cast<uint8_t>(mask >> 7 ? 0 : 1), static_cast<uint8_t>(mask & 0x7F), 0});
}

void Attack::stop() { ask(gen::CMD_STOP, {static_cast<uint8_t>(in_.byte() & 1)}); }

void Attack::resume() { ask(gen::CMD_RESUME, {}); }

void Attack::watchdog() {
  const uint8_t timeout = in_.byte();
  ask(gen::CMD_WATCHDOG, {timeout, 0, static_cast<uint8_t>(timeout & 1)});
}

void Attack::maintenance() { ask(gen::CMD_MAINTENANCE, {static_cast<uint8_t>(in_.byte() & 1)}); }

// Plausible limits.
void Attack::limits() {
  const uint8_t lowest = in_.byte(), speed = in_.byte();
  std::vector<uint8_t> body = {gen::JOINTS};
  for (uint8_t i = 0; i < gen::JOINTS; ++i) {
    const uint16_t minimum = static_cast<uint16_t>(lowest * 8), maximum = static_cast<uint16_t>(minimum + 1500);
    const uint16_t counts = static_cast<uint16_t>(100 + speed * 16);
    body.insert(body.end(), {low(minimum), high(minimum), low(maximum), high(maximum), low(counts), high(counts)});
  }
  ask(gen::CMD_LIMITS, body);
}

void Attack::noise() { w_.put_raw(in_.bytes(in_.byte())); }

void Attack::servo_noise() {
  w_.spoil();
  const std::vector<uint8_t> bytes = in_.bytes(in_.byte());
  w_.b.from_bus.insert(w_.b.from_bus.end(), bytes.begin(), bytes.end());
}

void Attack::again() { w_.repeat(in_.byte()); }

// A servo falls silent or comes back.
void Attack::silence() {
  w_.spoil();
  ServoModel& servo = w_.line().servos[in_.byte() % gen::JOINTS];
  servo.silent = !servo.silent;
}

// Time passes, or one of the further actions.
void Attack::longer() {
  const uint8_t what = in_.byte();
  if (what < 200) return w_.run(what * 1000u);
  const uint8_t how = in_.byte();
  if (what < 220) return follow(how);
  if (what < 232) return message(how);
  if (what < 240) return table(how);
  if (what < 248) return aim(how);
  host_rate(how);
}

// Whom the next frames are for: this board, all, several with it or without it, or anybody.
void Attack::aim(uint8_t how) {
  const int32_t whom[] = {gen::MODULE_ARM_7BOT_ARDUINO_TRX,
                          gen::ADDRESS_BROADCAST,
                          gen::ADDRESS_MULTICAST | 1 << gen::MODULE_ARM_7BOT_ARDUINO_TRX,
                          gen::ADDRESS_MULTICAST | 1 << 3,
                          how >> 3,
                          gen::ADDRESS_MULTICAST | how << 4,
                          -how,
                          gen::MODULE_ARM_7BOT_ARDUINO_TRX};
  w_.aim(whom[how & 7]);
}

// -- trajectories -----------------------------------------------------------------------------------

// The parts of a trajectory, from where the joints are or from anywhere.
void Attack::follow(uint8_t how) {
  const uint8_t mask = in_.byte();
  if (how & 4) {
    mask_ = mask & 0x7F;
    flags_ = static_cast<uint8_t>((how & 3) | (mask & 0x80 ? gen::TRAJECTORY_FLAG_FINE : 0));
    next_ = 0;
    for (uint8_t i = 0; i < gen::JOINTS; ++i) at_[i] = static_cast<int16_t>(w_.line().servos[i].position);
    ask(gen::CMD_TRAJECTORY_BEGIN, {kPath, flags_, mask_, 0, static_cast<uint8_t>(in_.byte() + 20), 0});
  }
  if (how & 8) ask(gen::CMD_TRAJECTORY_POINTS, points(in_.byte() % 7, how & 32));
  if (how & 16) ask(gen::CMD_TRAJECTORY_START, {kPath, 1, 0, 0, 0, 0});
  if (how & 64) ask(gen::CMD_TRAJECTORY_ABORT, {kPath});
  if (how & 128) ask(gen::CMD_TRAJECTORY_STATUS, {});
}

std::vector<uint8_t> Attack::points(uint8_t count, bool last) {
  std::vector<uint8_t> body = {kPath, last, low(next_), high(next_), count};
  const int unit = flags_ & gen::TRAJECTORY_FLAG_FINE ? 8 : 1;
  for (uint8_t n = 0; n < count; ++n, ++next_) {
    const uint16_t dt = next_ ? in_.word() : 0;
    body.insert(body.end(), {low(dt), high(dt)});
    for (uint8_t i = 0; i < gen::JOINTS; ++i) {
      if (!(mask_ & (1u << i))) continue;
      const int8_t way = next_ ? static_cast<int8_t>(in_.byte()) : static_cast<int8_t>(0);
      at_[i] = static_cast<int16_t>(at_[i] + way * 4);
      const uint32_t raw = static_cast<uint32_t>(at_[i] * unit);
      body.insert(body.end(), {low(raw), high(raw)});
      if (flags_ & 1) body.insert(body.end(), {in_.byte(), static_cast<uint8_t>(way >> 6)});
    }
  }
  return body;
}

// Any number of points at one place, perhaps more than fit.
std::vector<uint8_t> Attack::still_points(uint8_t count) {
  std::vector<uint8_t> body = {kPath, 0, low(next_), high(next_), count};
  const int unit = flags_ & gen::TRAJECTORY_FLAG_FINE ? 8 : 1;
  for (uint8_t n = 0; n < count; ++n, ++next_) {
    body.insert(body.end(), {static_cast<uint8_t>(next_ ? 100 : 0), 0});
    for (uint8_t i = 0; i < gen::JOINTS; ++i) {
      if (!(mask_ & (1u << i))) continue;
      const uint32_t raw = static_cast<uint32_t>(at_[i] * unit);
      body.insert(body.end(), {low(raw), high(raw)});
      if (flags_ & 1) body.insert(body.end(), {0, 0});
    }
  }
  return body;
}

// -- messages in fragments, and tables --------------------------------------------------------------

// Begins a message, and sends chunks of it: the next ones, any one, or all that are left.
void Attack::message(uint8_t how) {
  if (how & 1) begin_message(how >> 1 & 3);
  for (uint8_t n = how >> 3 & 7; n; --n) send_chunk(sent_++);
  if (how & 0x40) send_chunk(in_.byte() & 7);
  if (how & 0x80) ask_missing();
}

void Attack::begin_message(uint8_t kind) {
  chunk_ = static_cast<uint8_t>(1 + in_.byte() % 200);
  message_id_ = static_cast<uint16_t>(in_.byte() | w_.next_seq() << 8);
  message_cmd_ = kind < 2 ? gen::CMD_TRAJECTORY_POINTS : gen::CMD_SERVO_TABLE;
  if (kind == 0) message_ = points(in_.byte() % 24, true);
  if (kind == 1) message_ = still_points(in_.byte());
  if (kind == 2) message_ = table_body(true);
  if (kind == 3) {
    message_cmd_ = in_.byte();
    message_ = in_.bytes(in_.byte());
  }
  sent_ = 0;
}

void Attack::send_chunk(uint16_t index) {
  const size_t begin = std::min<size_t>(index * chunk_, message_.size());
  const size_t end = std::min<size_t>(begin + chunk_, message_.size());
  const uint16_t count = static_cast<uint16_t>((message_.size() + chunk_ - 1) / chunk_);
  std::vector<uint8_t> body = {low(message_id_), high(message_id_), low(index), high(index),
                               low(count),       high(count),       message_cmd_, 0};
  body.insert(body.end(), message_.begin() + static_cast<long>(begin), message_.begin() + static_cast<long>(end));
  w_.put_frame(gen::PROTO_HEXWIRE, gen::CMD_FRAGMENT, body, low(message_id_));
}

// Asks for chunks of a reply, perhaps of the last one.
void Attack::ask_missing() {
  const uint8_t which = in_.byte();
  const uint8_t count = which & 3;
  std::vector<uint8_t> body = {w_.seq(), static_cast<uint8_t>(which >> 2 & 7), count, 0};
  for (uint8_t i = 0; i < count; ++i) body.insert(body.end(), {static_cast<uint8_t>(in_.byte() & 3), 0});
  w_.put_frame(gen::PROTO_HEXWIRE, gen::CMD_FRAGMENT_MISSING, body, w_.seq());
}

void Attack::table(uint8_t how) {
  ask(gen::CMD_SERVO_TABLE, table_body(how & 1));
  if (how & 2) ask_missing();
}

std::vector<uint8_t> Attack::table_body(bool writes) {
  const uint8_t servo = in_.byte() & 7;
  const uint8_t first = in_.byte();
  const uint8_t size = in_.byte();
  const uint16_t count = writes ? static_cast<uint16_t>(size) : static_cast<uint16_t>(256 - first - size % 16);
  std::vector<uint8_t> body = {servo, first, low(count), high(count)};
  if (!writes) return body;
  std::vector<uint8_t> data = in_.bytes(size);
  data.resize(size);
  body.insert(body.end(), data.begin(), data.end());
  return body;
}

void Attack::host_rate(uint8_t how) {
  const uint32_t rates[] = {115200, 250000, 500000, 1000000, 9600, 0, 500000, 500000};
  const uint32_t rate = rates[how & 7];
  ask(gen::CMD_HOST_BAUD, {low(rate), high(rate), low(rate >> 16), low(rate >> 24)});
}

}  // namespace hexwire
