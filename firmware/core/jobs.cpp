#include "hot.h"  // first

// The commands that take the bus for more than one transaction, as lists of steps, and what runs them.
#include <string.h>

#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint16_t kPacketTimeoutUs = 20000;
constexpr uint8_t kMoreTries = 2;

}  // namespace

const Board::Step Board::kBoot[] = {Step::kReadPosition, Step::kReadTorque, Step::kReadCeiling, Step::kAimIfTorque,
                                    Step::kSendLegacy,   Step::kSendHls,    Step::kBooted};
const Board::Step Board::kMove[] = {Step::kReadCeiling, Step::kAimMove, Step::kSendLegacy, Step::kSendHls,
                                    Step::kReplyMove};
const Board::Step Board::kSyncWrite[] = {Step::kReadCeiling, Step::kAimSyncWrite, Step::kSendLegacy, Step::kSendHls,
                                         Step::kReplySyncWrite};
const Board::Step Board::kTorqueOn[] = {Step::kReadPosition, Step::kReadCeiling, Step::kAimPresent,
                                        Step::kSendLegacy,   Step::kSendHls,     Step::kSendTorque,
                                        Step::kReadTorque,   Step::kConfirmTorque};
const Board::Step Board::kTorqueOff[] = {Step::kSendTorque, Step::kReadTorque, Step::kConfirmTorque};
const Board::Step Board::kHold[] = {Step::kReadPosition, Step::kReadCeiling, Step::kAimIfTorque,  Step::kSendLegacy,
                                    Step::kSendHls,      Step::kReadTarget,  Step::kConfirmTarget};
const Board::Step Board::kPacket[] = {Step::kSendPacket, Step::kReplyPacket};
const Board::Step Board::kRaw[] = {Step::kSendRaw, Step::kReplyRaw};
const Board::Step Board::kState[] = {Step::kAwaitCycle, Step::kReplyState};
const Board::Step Board::kSave[] = {Step::kAwaitSaved};

void Board::start_job(const Step* program, Mask mask) {
  job_.active = true;
  job_.entered = false;
  job_.pc = 0;
  job_.repeats = 0;
  job_.program = program;
  job_.mask = mask;
  job_.targets.mask = 0;
}

void Board::drop_job() {
  job_.active = false;
  if (owner_ == Owner::kJob) owner_ = Owner::kNobody;
}

void Board::next_step() {
  ++job_.pc;
  job_.entered = false;
}

// One pass over everything that concerns the bus.
void Board::run_bus() {
  bus_.poll(last_us_);
  if (bus_.finished()) {
    const Owner owner = owner_;
    owner_ = Owner::kNobody;
    if (owner == Owner::kPoller) poller_.take_result(last_us_, ms_);
    if (owner == Owner::kJob && job_.entered) sweep_.take_result(last_us_, ms_);
  }
  if (!job_.active) start_request();
  // Whoever needs the line gets it before anything is worked out: it should not lie idle meanwhile.
  if (job_.active && needs_bus()) run_job();
  // While a host that speaks the chapter's dialect is sending, the line is kept free for its request.
  const bool keep_free = decoder_.receiving() && (chapter_heard_ || !poller_.busy(ms_));
  const bool wanted = job_.active && needs_bus();
  if (bus_.idle() && !wanted && !keep_free && poller_.start(last_us_, ms_)) owner_ = Owner::kPoller;
  poller_.digest();
  run_job();
}

bool Board::start_request() {
  if (!queue_.front(&now_running_) || !may_send()) return false;
  execute();
  return true;
}

void Board::run_job() {
  while (job_.active ? run_step() : start_request()) {
  }
}

// Whether the next step starts something on the bus or needs what came from it. Others run beside a transaction.
bool Board::needs_bus() const {
  switch (job_.program[job_.pc]) {
    case Step::kReadCeiling:
      return job_.entered || ceiling_unknown();
    case Step::kReadPosition:
    case Step::kReadTorque:
    case Step::kReadTarget:
    case Step::kSendLegacy:
    case Step::kSendHls:
    case Step::kSendTorque:
    case Step::kSendPacket:
    case Step::kSendRaw:
    case Step::kReplyPacket:
    case Step::kReplyRaw:
      return true;
    default:
      return false;
  }
}

// Joints of the job that cannot be moved before their current ceiling is known.
Mask Board::ceiling_unknown() const {
  Mask unknown = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    const Joint& joint = joints_[i];
    if (joint.present && !joint.ceiling_known && joint.series == gen::SERIES_HLS) unknown |= only(i);
  }
  return unknown & job_.mask;
}

// False if the step needs more time.
bool Board::run_step() {
  const Step step = job_.program[job_.pc];
  if (!bus_.idle() && needs_bus()) return false;
  switch (step) {
    case Step::kReadPosition:
      return sweep(Item::kPosition, job_.mask);
    case Step::kReadTorque:
      return sweep(Item::kTorque, job_.mask);
    case Step::kReadTarget:
      return sweep(Item::kTarget, job_.targets.mask);
    case Step::kReadCeiling:
      return sweep(Item::kCeiling, ceiling_unknown());
    case Step::kAimPresent:
      aim(job_.mask);
      return true;
    case Step::kAimIfTorque:
      // A joint without torque stays without: writing it a target could switch it on.
      aim(job_.mask & torqued());
      return true;
    case Step::kAimMove:
      aim_move();
      return true;
    case Step::kAimSyncWrite:
      aim_sync_write();
      return true;
    case Step::kSendLegacy:
    case Step::kSendHls: {
      const uint8_t series = step == Step::kSendLegacy ? gen::SERIES_SEVEN_BOT : gen::SERIES_HLS;
      next_step();
      if (!joints_.make_targets(bus_, job_.targets, series)) return true;
      break;
    }
    case Step::kSendTorque:
      next_step();
      if (!joints_.make_torque(bus_, job_.mask, job_.argument && now_running_.cmd == gen::CMD_TORQUE)) return true;
      break;
    case Step::kSendPacket:
      next_step();
      send_packet();
      owner_ = Owner::kJob;
      return false;
    case Step::kSendRaw:
      next_step();
      send_raw();
      owner_ = Owner::kJob;
      return false;
    case Step::kConfirmTorque:
      confirm(false);
      return true;
    case Step::kConfirmTarget:
      confirm(true);
      return true;
    case Step::kReplyMove:
      reply_move();
      return true;
    case Step::kReplySyncWrite:
      reply(gen::STATUS_OK, 0);
      return true;
    case Step::kReplyPacket:
      reply_packet();
      return true;
    case Step::kReplyRaw:
      reply_raw();
      return true;
    case Step::kAwaitCycle:
      if (job_.cycles == poller_.cycles()) return false;
      next_step();
      return true;
    case Step::kReplyState:
      reply(gen::STATUS_OK, put_state(job_.argument));
      return true;
    case Step::kAwaitSaved: {
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
    case Step::kBooted:
      job_.active = false;
      return true;
  }
  // A packet without an answer is in the send buffer.
  bus_.start_silent();
  owner_ = Owner::kJob;
  return false;
}

// Reads an item of many joints; goes on to the next step when all are through.
bool Board::sweep(Item item, Mask mask) {
  if (!job_.entered) {
    sweep_.begin(mask, item, true);
    job_.entered = true;
  }
  if (sweep_.start_next(ms_)) {
    owner_ = Owner::kJob;
    return false;
  }
  sweep_.digest();
  next_step();
  return true;
}

void Board::put_target(uint8_t joint, int16_t position, uint32_t duration_ms) {
  job_.targets.mask |= only(joint);
  job_.targets.position[joint] = position;
  set_duration(joint, duration_ms > 0xFFFF ? 0xFFFF : static_cast<uint16_t>(duration_ms));
}

void Board::set_duration(uint8_t joint, uint16_t duration_ms) {
  job_.targets.duration_ms[joint] = duration_ms;
  if (joints_[joint].series == gen::SERIES_HLS) {
    job_.targets.speed[joint] = joints_.hls_speed(joint, job_.targets.position[joint], duration_ms);
  }
}

int16_t Board::clamp(uint8_t joint, int32_t wanted) {
  const int16_t low = settings_.minimum(joint);
  const int16_t high = settings_.maximum(joint);
  const int16_t target = wanted < low ? low : wanted > high ? high : static_cast<int16_t>(wanted);
  joints_[joint].clamped = target != wanted;
  return target;
}

// A duration, lengthened where the joint would exceed its speed limit. Mostly it would not: then there is no
// division, which on an AVR takes longer than a byte on the line.
uint32_t Board::at_least(uint32_t duration_ms, uint8_t joint, int16_t target) const {
  const uint16_t speed = settings_.speed(joint);
  const uint32_t way = static_cast<uint32_t>(joints_.distance(joint, target)) * 1000;
  if (duration_ms >= 0x10000 || way <= duration_ms * speed) return duration_ms;
  return (way + speed - 1) / speed;
}

void Board::aim(Mask mask) {
  for (uint8_t i = 0; i < kJoints; ++i) {
    const Joint& joint = joints_[i];
    const bool writable = joint.series != gen::SERIES_HLS || joint.ceiling_known;
    if ((mask & only(i)) && joint.present && joint.known && writable) put_target(i, joint.position, 0);
  }
  next_step();
}

void Board::aim_move() {
  const uint8_t* p = now_running_.body;
  uint32_t duration = get16(p + gen::JOINT_MOVE_REQUEST_DURATION_MS);
  for (uint8_t row = 0; row < p[gen::JOINT_MOVE_REQUEST_COUNT]; ++row) {
    const uint8_t* at = p + gen::JOINT_MOVE_REQUEST_SIZE + row * gen::JOINT_MOVE_REQUEST_ROW_SIZE;
    const int16_t wanted = static_cast<int16_t>(get16(at + gen::JOINT_MOVE_REQUEST_ROW_POSITION));
    for (uint8_t i = 0; i < kJoints; ++i) {
      const Joint& joint = joints_[i];
      if (at[0] != joint.id && at[0] != gen::BROADCAST_ID) continue;
      if (!joint.present || (joint.series == gen::SERIES_HLS && !joint.ceiling_known)) continue;
      job_.targets.mask |= only(i);
      job_.targets.position[i] = clamp(i, wanted);
      duration = at_least(duration, i, job_.targets.position[i]);
    }
  }
  job_.duration_ms = duration > 0xFFFF ? 0xFFFF : static_cast<uint16_t>(duration);
  for (uint8_t i = 0; i < kJoints; ++i) set_duration(i, job_.duration_ms);
  next_step();
}

// The chapter's move: little-endian position and run time for any id; what the series need is made of it.
void Board::aim_sync_write() {
  const uint8_t* p = now_running_.body;
  const uint8_t* end = p + now_running_.size - 1;
  for (const uint8_t* at = p + 7; at + 5 <= end; at += 5) {
    const uint8_t i = joints_.find(at[0]);
    // The chapter's board takes nothing after an id it does not know.
    if (i == kNoJoint) break;
    const Joint& joint = joints_[i];
    if (joint.series == gen::SERIES_HLS && !joint.ceiling_known) continue;
    const int16_t target = clamp(i, get16(at + 1));
    const uint32_t wish = get16(at + 3);
    put_target(i, target, joint.known ? at_least(wish, i, target) : wish);
  }
  next_step();
}

Mask Board::torqued() const {
  Mask mask = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (joints_[i].torque_on) mask |= only(i);
  }
  return mask;
}

void Board::confirm(bool target) {
  const bool on = job_.argument && now_running_.cmd == gen::CMD_TORQUE;
  Mask confirmed = 0;
  bool wrong = false;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(job_.mask & only(i))) continue;
    if (target && !(job_.targets.mask & only(i))) {
      // It was written nothing: limp it does not move.
      if (joints_[i].present && !joints_[i].torque_on) confirmed |= only(i);
      continue;
    }
    const int16_t wanted = target ? job_.targets.position[i] : on ? 1 : 0;
    if (!(sweep_.answered() & only(i))) continue;
    if (sweep_.value(i) == wanted) {
      confirmed |= only(i);
    } else {
      wrong = true;
    }
  }
  if (wrong && job_.repeats < kMoreTries) {
    // A servo is there, but did not get it: a packet without an answer may be lost to noise.
    ++job_.repeats;
    ++stats_.bus_retries;
    job_.pc = 0;
    job_.entered = false;
    return;
  }
  uint8_t* p = body();
  p[gen::STOP_REPLY_MODE] = job_.argument;
  put16(p + gen::STOP_REPLY_MASK, confirmed);
  reply(confirmed == job_.mask ? gen::STATUS_OK : gen::STATUS_SERVO_SILENT, gen::STOP_REPLY_SIZE);
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

void Board::send_packet() {
  const uint8_t* packet = now_running_.body;
  const uint8_t size = now_running_.size;
  const uint8_t instruction = packet[4];
  bus_.take(packet, size);
  Expect expect = {kAnyHeader, 0, instruction == gen::INST_PING, 2, kPacketTimeoutUs};
  if (instruction == gen::INST_SYNC_READ) {
    expect.parameters = packet[6];
    bus_.start_many(packet + 7, static_cast<uint8_t>(size - 8), expect);
  } else if (instruction == gen::INST_REBOOT || (packet[2] == gen::BROADCAST_ID && !is_read(instruction))) {
    bus_.start_silent();
  } else {
    if (instruction == gen::INST_READ) expect.parameters = packet[6];
    if (!is_read(instruction)) expect.tries = 1;
    bus_.start_single(expect);
  }
}

void Board::send_raw() {
  const uint8_t* p = now_running_.body;
  const uint8_t timeout = p[gen::TRANSACT_REQUEST_TIMEOUT_MS];
  bus_.take(p + gen::TRANSACT_REQUEST_PACKET, static_cast<uint8_t>(now_running_.size - gen::TRANSACT_REQUEST_SIZE));
  bus_.start_raw(p[gen::TRANSACT_REQUEST_REPLY_LENGTH], timeout ? timeout * 1000UL : kPacketTimeoutUs);
}

// The answer to PING or READ: whole status packets, one after the other.
void Board::reply_packet() {
  const uint8_t* request = now_running_.body;
  const bool many = request[4] == gen::INST_SYNC_READ;
  const uint8_t wanted = many ? static_cast<uint8_t>(now_running_.size - 8) : 1;
  uint8_t size = 0;
  for (uint8_t i = 0; i < wanted; ++i) {
    const uint8_t* packet = bus_.answer(i);
    if (packet == nullptr) continue;
    const uint8_t length = bus_.answer_size(i);
    memcpy(body() + size, packet, length);
    // The chapter's board makes 16-bit answers of legacy servos little-endian; the checksum does not mind.
    if (length == 8 && packet[1] == 0xF5 && request[4] == gen::INST_READ) {
      body()[size + 5] = packet[6];
      body()[size + 6] = packet[5];
    }
    size = static_cast<uint8_t>(size + length);
  }
  if (size || request[2] == gen::BROADCAST_ID) note_write(request);
  if (size == 0) return refuse_packet(gen::STATUS_SERVO_SILENT);
  if (now_running_.proto == gen::PROTO_CHAPTER) return reply_chapter(size);
  reply(gen::STATUS_OK, size);
}

// The answer to TRANSACT: the bytes as they came, be they as many as were asked for or not.
void Board::reply_raw() {
  const uint8_t wanted = now_running_.body[gen::TRANSACT_REQUEST_REPLY_LENGTH];
  uint8_t size = wanted ? bus_.answer_size() : 0;
  if (size > wanted) size = wanted;
  if (size) memcpy(body(), bus_.answer(), size);
  if (size == wanted) note_write(now_running_.body + gen::TRANSACT_REQUEST_PACKET);
  reply(size || wanted == 0 ? gen::STATUS_OK : gen::STATUS_SERVO_SILENT, size);
}

}  // namespace hexwire
