// Tables of registers: read and written piece by piece, sent and received in fragments where they are long. See
// PROTOCOL.md, section 6.10.
#include <string.h>

#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint8_t kHead = gen::SERVO_TABLE_REQUEST_SIZE;
constexpr uint8_t kMostReadAtOnce = 64;
constexpr uint8_t kMostWrittenAtOnce = 32;
constexpr uint8_t kMostOfLegacy = 2;
constexpr uint16_t kReadTimeoutUs = 2500;
constexpr uint16_t kWriteTimeoutUs = 20000;
constexpr uint16_t kRegisters = 0x100;

static_assert(kHead == gen::SERVO_TABLE_REPLY_SIZE, "one layout for request and reply");
static_assert(gen::FRAGMENT_REQUEST_SIZE + ReplyStore::kMostReply <= kMaxBody, "a chunk fits into a frame");

uint8_t put_head(uint8_t* p, uint8_t servo_id, uint8_t first, uint16_t count) {
  p[gen::SERVO_TABLE_REPLY_SERVO_ID] = servo_id;
  p[gen::SERVO_TABLE_REPLY_FIRST] = first;
  put16(p + gen::SERVO_TABLE_REPLY_COUNT, count);
  return kHead;
}

}  // namespace

// What a request names; false if there is no such table.
bool Board::find_table(const uint8_t* p, TableRange* range) const {
  range->joint = joints_.find(p[gen::SERVO_TABLE_REQUEST_SERVO_ID]);
  range->first = p[gen::SERVO_TABLE_REQUEST_FIRST];
  range->count = get16(p + gen::SERVO_TABLE_REQUEST_COUNT);
  return range->joint != kNoJoint && range->count != 0 && range->count <= kRegisters - range->first;
}

void Board::servo_table() {
  const uint8_t* p = now_running_.body;
  if (now_running_.size < kHead) return refuse(gen::STATUS_BAD_LENGTH);
  TableRange range;
  if (!find_table(p, &range)) return refuse(gen::STATUS_BAD_RANGE);
  const uint8_t given = static_cast<uint8_t>(now_running_.size - kHead);
  if (given == 0) return read_table(range);
  const uint8_t status = may_write_table();
  if (status != gen::STATUS_OK) return refuse(status);
  if (given != range.count) return refuse(gen::STATUS_BAD_LENGTH);
  table_.chunk = 0;
  write_table(range, range.first, p + kHead, given);
}

// -- reading ----------------------------------------------------------------------------------------

void Board::read_table(const TableRange& range) {
  if (path_is_near()) return refuse(gen::STATUS_BUSY);
  table_.range = range;
  table_.phase = TablePhase::kRead;
  const uint16_t whole = static_cast<uint16_t>(kHead + range.count);
  table_.in_fragments = whole > ReplyStore::kMostReply;
  if (!table_.in_fragments) {
    table_.at = range.first;
    table_.end = static_cast<uint16_t>(range.first + range.count);
    return start_reading();
  }
  if (outbox_.open_for_another(now_running_.src)) return refuse(gen::STATUS_BUSY);
  const uint8_t chunks = static_cast<uint8_t>((whole + ReplyStore::kMostReply - 1) / ReplyStore::kMostReply);
  outbox_.begin(now_running_.src, now_running_.seq, chunks, ms_);
  sent_table_ = range;
  read_chunk();
}

// Whether targets of a trajectory must not wait for a table.
bool Board::path_is_near() const { return trajectory_.waits() || trajectory_.moving(); }

// Begins to read the next chunk of the message.
void Board::read_chunk() {
  const uint16_t begin = static_cast<uint16_t>(outbox_.wanted() * ReplyStore::kMostReply);
  const uint16_t end = static_cast<uint16_t>(table_.range.first + table_.range.count);
  const uint16_t most = static_cast<uint16_t>(table_.range.first + begin + ReplyStore::kMostReply - kHead);
  table_.at = static_cast<uint16_t>(table_.range.first + (begin ? begin - kHead : 0));
  table_.end = most < end ? most : end;
  start_reading();
}

void Board::start_reading() {
  table_.filled = 0;
  table_.bytes = stored_.scratch();
  start_job(kTable, 0);
}

// FRAGMENT_MISSING: the host misses chunks of a reply, or has them all.
void Board::send_again() {
  const uint8_t* p = now_running_.body;
  const uint8_t size = now_running_.size;
  constexpr uint8_t kFixed = gen::FRAGMENT_MISSING_REQUEST_SIZE;
  if (size < kFixed) return refuse(gen::STATUS_BAD_LENGTH);
  const uint16_t count = get16(p + gen::FRAGMENT_MISSING_REQUEST_COUNT);
  if (static_cast<uint16_t>(size - kFixed) != 2UL * count) return refuse(gen::STATUS_BAD_LENGTH);
  if (!outbox_.is(now_running_.src, get16(p + gen::FRAGMENT_MISSING_REQUEST_MESSAGE_ID))) return pass_over();
  if (count == 0) outbox_.close();
  for (uint8_t i = 0; i < count; ++i) outbox_.want(get16(p + kFixed + 2 * i));
  if (path_is_near()) outbox_.want_none();
  if (!outbox_.open() || !outbox_.wants_any()) return pass_over();
  answer_for(gen::CMD_SERVO_TABLE, outbox_.seq());
  table_.range = sent_table_;
  table_.phase = TablePhase::kRead;
  table_.in_fragments = true;
  read_chunk();
}

// -- writing ----------------------------------------------------------------------------------------

uint8_t Board::may_write_table() const {
  if (stopped()) return gen::STATUS_STOPPED;
  return in_maintenance() ? gen::STATUS_OK : gen::STATUS_FORBIDDEN;
}

void Board::begin_table(const Chunk& chunk) {
  if (chunk.size < kHead) return refuse(gen::STATUS_BAD_LENGTH);
  TableRange range;
  if (!find_table(chunk.data, &range)) return refuse(gen::STATUS_BAD_RANGE);
  const uint8_t status = may_write_table();
  if (status != gen::STATUS_OK) return refuse(status);
  if (!inbox_.begin(chunk, static_cast<uint16_t>(kHead + range.count), ms_)) return refuse(gen::STATUS_BAD_LENGTH);
  received_table_ = range;
  table_.chunk = chunk.size;
  write_table(range, range.first, chunk.data + kHead, static_cast<uint8_t>(chunk.size - kHead));
}

void Board::use_table(const Chunk& chunk) {
  const uint8_t status = may_write_table();
  if (status != gen::STATUS_OK) return end_message(status);
  const TableRange& range = received_table_;
  table_.chunk = chunk.size;
  write_table(range, static_cast<uint16_t>(range.first + range.count - inbox_.left()), chunk.data, chunk.size);
}

// Writes what came in one frame or chunk, if all of it may pass.
void Board::write_table(const TableRange& range, uint16_t at, const uint8_t* data, uint8_t size) {
  table_.range = range;
  table_.phase = TablePhase::kCompare;
  table_.at = at;
  table_.end = static_cast<uint16_t>(at + size);
  table_.data = data;
  const uint8_t id = joints_[range.joint].id;
  const uint8_t status = gate_.judge_write(id, static_cast<uint8_t>(at), size, data, circumstances());
  if (status != gen::STATUS_OK) return fail_table(status);
  if (size == 0) return table_written();
  start_job(kTable, 0);
}

void Board::table_written() {
  // The host may have been restarted meanwhile.
  if (table_.chunk && (!inbox_.open() || !chunk_used(table_.chunk))) return pass_over();
  const TableRange& range = table_.range;
  reply(gen::STATUS_OK, put_head(body(), joints_[range.joint].id, range.first, range.count));
}

void Board::fail_table(uint8_t status) {
  if (table_.phase == TablePhase::kRead) {
    if (table_.in_fragments) outbox_.close();
    return refuse(status);
  }
  if (table_.chunk) return end_message(status);
  refuse(status);
}

// -- the steps of the job ---------------------------------------------------------------------------

// Starts the transaction of the next piece.
void Board::ask_table() {
  const Joint& joint = joints_[table_.range.joint];
  const bool legacy = joint.series == gen::SERIES_SEVEN_BOT;
  const uint8_t most = legacy ? kMostOfLegacy : table_.phase == TablePhase::kRead ? kMostReadAtOnce : kMostWrittenAtOnce;
  const uint16_t left = static_cast<uint16_t>(table_.end - table_.at);
  const uint8_t header = legacy ? 0xF5 : 0xFF;
  table_.piece = left < most ? static_cast<uint8_t>(left) : most;
  owner_ = Owner::kJob;
  if (table_.phase == TablePhase::kWrite) {
    note_register(joint.id, static_cast<uint8_t>(table_.at), table_.data, table_.piece);
    bus_.begin(joint.id, gen::INST_WRITE);
    bus_.add(static_cast<uint8_t>(table_.at));
    for (uint8_t i = 0; i < table_.piece; ++i) bus_.add(table_.data[i]);
    return bus_.start_single(Expect{header, 0, false, 1, kWriteTimeoutUs});
  }
  bus_.begin(joint.id, gen::INST_READ);
  bus_.add(static_cast<uint8_t>(table_.at));
  bus_.add(table_.piece);
  bus_.start_single(Expect{header, table_.piece, false, 2, kReadTimeoutUs});
}

// Takes the result of the transaction.
void Board::take_table() {
  if (table_.phase == TablePhase::kWrite) {
    // Not every servo confirms a write, so it is read back in any case.
    table_.phase = TablePhase::kVerify;
    return back_to(Step::kAskTable);
  }
  const uint8_t* answer = bus_.answer();
  if (answer == nullptr) return fail_table(gen::STATUS_SERVO_SILENT);
  if (table_.phase == TablePhase::kRead) {
    memcpy(table_.bytes + table_.filled, answer + 5, table_.piece);
    table_.filled = static_cast<uint8_t>(table_.filled + table_.piece);
  } else if (memcmp(answer + 5, table_.data, table_.piece) != 0) {
    if (table_.phase == TablePhase::kVerify) return fail_table(gen::STATUS_SERVO_FAULT);
    table_.phase = TablePhase::kWrite;
    return back_to(Step::kAskTable);
  } else {
    table_.phase = TablePhase::kCompare;
    table_.data += table_.piece;
  }
  table_.at = static_cast<uint16_t>(table_.at + table_.piece);
  if (table_.at != table_.end) return back_to(Step::kAskTable);
  next_step();
}

// Answers, or sends a chunk, when there is room; false if there is none yet.
bool Board::reply_table() {
  if (!may_send()) return false;
  if (table_.phase != TablePhase::kRead) {
    table_written();
    return true;
  }
  if (table_.in_fragments && !outbox_.open()) {
    pass_over();
    return true;
  }
  const TableRange& range = table_.range;
  uint8_t* p = body();
  const uint8_t index = table_.in_fragments ? outbox_.wanted() : 0;
  if (table_.in_fragments) p = put_fragment(p, index);
  if (index == 0) p += put_head(p, joints_[range.joint].id, range.first, range.count);
  memcpy(p, table_.bytes, table_.filled);
  const uint8_t size = static_cast<uint8_t>(p + table_.filled - body());
  if (!table_.in_fragments) {
    reply(gen::STATUS_OK, size);
    return true;
  }
  send(gen::PROTO_HEXWIRE, now_running_.src, now_running_.seq, gen::CMD_FRAGMENT, 0, size);
  outbox_.sent(index, ms_);
  if (outbox_.wants_any()) {
    read_chunk();
  } else {
    pass_over();
  }
  return true;
}

// The head of a fragment; returns its end.
uint8_t* Board::put_fragment(uint8_t* p, uint8_t index) const {
  put16(p + gen::FRAGMENT_REQUEST_MESSAGE_ID, outbox_.id());
  put16(p + gen::FRAGMENT_REQUEST_INDEX, index);
  put16(p + gen::FRAGMENT_REQUEST_COUNT, outbox_.chunks());
  p[gen::FRAGMENT_REQUEST_CMD] = gen::CMD_SERVO_TABLE;
  p[gen::FRAGMENT_REQUEST_CMD_EXT] = gen::EXT_REPLY | gen::STATUS_OK;
  return p + gen::FRAGMENT_REQUEST_SIZE;
}

}  // namespace hexwire
