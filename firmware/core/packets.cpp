// A host's servo packets: through the gate, to the bus, and their answers back. See PROTOCOL.md, sections 5 and 6.4.
#include <string.h>

#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint16_t kPacketTimeoutUs = 20000;
constexpr uint8_t kBoardErrorSize = 6;

}  // namespace

const uint8_t* Board::packet() const {
  return now_running_.cmd == gen::CMD_TRANSACT ? now_running_.body + gen::TRANSACT_REQUEST_PACKET : now_running_.body;
}

uint8_t Board::packet_size() const {
  return now_running_.cmd == gen::CMD_TRANSACT ? static_cast<uint8_t>(now_running_.size - gen::TRANSACT_REQUEST_SIZE)
                                               : now_running_.size;
}

Gate::Circumstances Board::circumstances() const {
  return Gate::Circumstances{stopped(), in_maintenance(), now_running_.proto == gen::PROTO_CHAPTER, path_joints()};
}

// PING, READ and TRANSACT of both dialects.
void Board::pass_packet() {
  if (now_running_.cmd == gen::CMD_TRANSACT) {
    if (now_running_.size < gen::TRANSACT_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
    if (now_running_.body[gen::TRANSACT_REQUEST_REPLY_LENGTH] > kMaxHostAnswer) return refuse(gen::STATUS_BAD_RANGE);
  }
  if (!Gate::well_formed(packet(), packet_size())) return refuse_packet(gen::STATUS_BAD_RANGE);
  const Gate::Verdict verdict = gate_.judge(packet(), packet_size(), circumstances());
  if (verdict.status != gen::STATUS_OK) return refuse_packet(verdict.status);
  switch (verdict.way) {
    case Gate::Way::kAsItIs:
      return start_job(kPass, 0);
    case Gate::Way::kTargets:
      start_job(kSteer, verdict.mask);
      return skip_reads();
    case Gate::Way::kTorqueOn:
      return start_job(kGrant, verdict.mask);
  }
}

// The chapter's move, in either dialect; dialect 1 has no answer to it.
void Board::pass_move() {
  uint8_t status = gen::STATUS_BAD_RANGE;
  Mask mask = 0;
  if (Gate::is_move(now_running_.body, now_running_.size)) {
    const Gate::Verdict verdict = gate_.judge_move(now_running_.body, now_running_.size, circumstances());
    status = verdict.status;
    mask = verdict.mask;
  }
  if (status != gen::STATUS_OK) return reply(status, 0);
  start_job(kSyncWrite, mask);
  skip_reads();
}

void Board::aim_sync_write() {
  const Gate::Verdict verdict = gate_.judge_move(now_running_.body, now_running_.size, circumstances());
  if (verdict.status != gen::STATUS_OK) return reply(verdict.status, 0);
  job_.bad = verdict.silent | verdict.unclear | lacking(Lack::kCeiling);
  gate_.aim_move(now_running_.body, now_running_.size, verdict.mask & static_cast<Mask>(~job_.bad), ms_, &job_.targets);
  next_step();
}

// Asks the gate again, now that everything it needs has been read.
void Board::judge_packet() {
  const Gate::Verdict verdict = gate_.judge(packet(), packet_size(), circumstances());
  if (verdict.status != gen::STATUS_OK) return refuse_packet(verdict.status);
  if (verdict.unclear | lacking(Lack::kCeiling)) return refuse_packet(gen::STATUS_SERVO_SILENT);
  next_step();
}

// Sends the host's packet, or the one that the gate has put into the send buffer instead.
void Board::start_packet(bool rewritten) {
  const uint8_t* p = packet();
  const uint8_t size = packet_size();
  const uint8_t instruction = p[4];
  if (!rewritten) {
    note_packet(p);
    bus_.take(p, size);
  }
  owner_ = Owner::kJob;
  if (now_running_.cmd == gen::CMD_TRANSACT) {
    const uint8_t timeout = now_running_.body[gen::TRANSACT_REQUEST_TIMEOUT_MS];
    return bus_.start_raw(now_running_.body[gen::TRANSACT_REQUEST_REPLY_LENGTH],
                          timeout ? timeout * 1000UL : kPacketTimeoutUs);
  }
  Expect expect = {kAnyHeader, 0, instruction == gen::INST_PING, 2, kPacketTimeoutUs};
  if (instruction == gen::INST_SYNC_READ) {
    expect.parameters = p[6];
    bus_.start_many(static_cast<uint8_t>(size - 8), expect);
  } else if (instruction == gen::INST_REBOOT || (p[2] == gen::BROADCAST_ID && !is_read(instruction))) {
    bus_.start_silent();
  } else {
    if (instruction == gen::INST_READ) expect.parameters = p[6];
    if (!is_read(instruction)) expect.tries = 1;
    bus_.start_single(expect);
  }
}

// Sends the targets of one series; false if the packet has no joint of it.
bool Board::send_targets(uint8_t series) {
  if (!gate_.make_targets(bus_, packet(), series, ms_)) return false;
  note_targets(job_.mask & joints_.with_series(series));
  if (packet()[4] == gen::INST_WRITE) {
    start_packet(true);
  } else {
    bus_.start_silent();
    owner_ = Owner::kJob;
  }
  return true;
}

// A target switches torque on. The table is updated as the packet is sent: a stop may come before the answer.
void Board::note_targets(Mask mask) {
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(mask & only(i)) || joints_[i].torque_on) continue;
    poller_.digest();  // the result of an earlier read must not be used after this packet
    joints_[i].torque_on = true;
    joints_[i].torque_known = false;
  }
}

void Board::note_packet(const uint8_t* p) {
  const uint8_t size = static_cast<uint8_t>(p[3] + 4);
  if (p[4] == gen::INST_WRITE) return note_register(p[2], p[5], p + 6, static_cast<uint8_t>(size - 7));
  if (p[4] != gen::INST_SYNC_WRITE) return;
  for (uint16_t at = 7; at + p[6] + 1U < size; at = static_cast<uint16_t>(at + p[6] + 1)) {
    note_register(p[at], p[5], p + at + 1, p[6]);
  }
}

void Board::note_register(uint8_t servo_id, uint8_t address, const uint8_t* data, uint8_t size) {
  const uint8_t at = gen::HLS_REG_TORQUE_ENABLE;
  if (address > at || at - address >= size) return;
  poller_.digest();
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (servo_id != joints_[i].id && servo_id != gen::BROADCAST_ID) continue;
    joints_[i].torque_on = data[at - address] == 1;
    joints_[i].torque_known = false;
  }
}

// A packet made by the board. As on the chapter's board, its length byte is 6 except for a read.
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

// The answer in dialect 1 to a request that is not executed: the same as for a silent servo.
uint8_t Board::silent_servo(const Request& request) {
  if (!sound_packet(request.body, request.size)) return board_error(0xFF, gen::BOARD_ERROR_COMMAND_UNKNOWN);
  const uint8_t error = request.cmd == gen::CMD_PING ? gen::BOARD_ERROR_PING_SILENT : gen::BOARD_ERROR_READ_SILENT;
  return board_error(request.body[2], error);
}

void Board::refuse_packet(uint8_t status) {
  if (now_running_.proto == gen::PROTO_HEXWIRE) return refuse(status);
  reply_chapter(silent_servo(now_running_));
}

void Board::reply_packet() {
  if (now_running_.cmd == gen::CMD_TRANSACT) return reply_raw();
  // Whole status packets, one after the other.
  const uint8_t* request = now_running_.body;
  const bool many = request[4] == gen::INST_SYNC_READ;
  const uint8_t wanted = many ? static_cast<uint8_t>(now_running_.size - 8) : 1;
  uint8_t size = 0;
  for (uint8_t i = 0; i < wanted; ++i) {
    const uint8_t* packet = bus_.answer(i);
    if (packet == nullptr) continue;
    const uint8_t length = bus_.answer_size(i);
    memcpy(body() + size, packet, length);
    // The chapter's board makes 16-bit answers of legacy servos little-endian; the checksum stays the same.
    if (length == 8 && packet[1] == 0xF5 && request[4] == gen::INST_READ) {
      body()[size + 5] = packet[6];
      body()[size + 6] = packet[5];
    }
    size = static_cast<uint8_t>(size + length);
  }
  if (size == 0) return refuse_packet(gen::STATUS_SERVO_SILENT);
  if (now_running_.proto == gen::PROTO_CHAPTER) return reply_chapter(size);
  reply(gen::STATUS_OK, size);
}

// The answer to TRANSACT: the bytes as they arrived, even if they are fewer than requested.
void Board::reply_raw() {
  const uint8_t wanted = now_running_.body[gen::TRANSACT_REQUEST_REPLY_LENGTH];
  uint8_t size = wanted && bus_.answer() != nullptr ? bus_.answer_size() : 0;
  if (size > wanted) size = wanted;
  if (size) memcpy(body(), bus_.answer(), size);
  reply(size || wanted == 0 ? gen::STATUS_OK : gen::STATUS_SERVO_SILENT, size);
}

}  // namespace hexwire
