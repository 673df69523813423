// Messages in fragments: a board takes the chunks of a message one after the other, and uses each at once. See
// PROTOCOL.md, section 6.10. Replies in fragments are made in tables.cpp.
#include <string.h>

#include "board.h"
#include "bytes.h"

namespace hexwire {

void Board::take_fragment() {
  if (now_running_.size < gen::FRAGMENT_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const Chunk chunk = Chunk::parse(now_running_.src, now_running_.body, now_running_.size);
  const bool sound = chunk.index < chunk.count && now_running_.body[gen::FRAGMENT_REQUEST_CMD_EXT] == 0;
  if (!sound) return refuse(gen::STATUS_BAD_RANGE);
  answer_for(chunk.cmd, chunk.seq());
  if (is_void(now_running_)) return refuse(gen::STATUS_STOPPED);
  if (inbox_.is(chunk)) return inbox_.expects(chunk) ? use_chunk(chunk) : pass_over();
  if (inbox_.was(chunk, ms_)) return confirm_again(chunk);
  if (inbox_.open_for_another(chunk.src)) return refuse(gen::STATUS_BUSY);
  if (chunk.index) {
    ask_for(chunk.src, chunk.id, 0, 1);
    return pass_over();
  }
  drop_message();
  begin_message(chunk);
}

// From here on a reply is one to the message whose chunk is executed.
void Board::answer_for(uint8_t cmd, uint8_t seq) {
  now_running_.cmd = cmd;
  now_running_.seq = seq;
  now_running_.size = 0;
}

// Whether a stop has voided a request.
bool Board::is_void(const Request& request) const {
  const Frame frame = {request.src, 0, request.proto, request.seq, request.cmd, 0, request.size, request.body};
  return voided_.holds(frame, ms_);
}

// Ends a request that has no answer.
void Board::pass_over() {
  job_.active = false;
  queue_.pop();
}

void Board::ask_for(int32_t src, uint16_t id, uint16_t first, uint8_t count) {
  uint8_t* p = body();
  put16(p + gen::FRAGMENT_MISSING_REQUEST_MESSAGE_ID, id);
  put16(p + gen::FRAGMENT_MISSING_REQUEST_COUNT, count);
  for (uint8_t i = 0; i < count; ++i) put16(p + gen::FRAGMENT_MISSING_REQUEST_SIZE + 2 * i, static_cast<uint16_t>(first + i));
  const uint8_t size = static_cast<uint8_t>(gen::FRAGMENT_MISSING_REQUEST_SIZE + 2 * count);
  send(gen::PROTO_HEXWIRE, src, static_cast<uint8_t>(id), gen::CMD_FRAGMENT_MISSING, 0, size);
}

void Board::ask_on() {
  uint16_t first;
  const uint8_t count = inbox_.ask(&first, ms_);
  ask_for(inbox_.src(), inbox_.id(), first, count);
}

// The host has not heard that the message is finished.
void Board::confirm_again(const Chunk& chunk) {
  ask_for(chunk.src, chunk.id, 0, 0);
  const Frame whole = {chunk.src, 0, gen::PROTO_HEXWIRE, chunk.seq(), chunk.cmd, 0, 0, chunk.data};
  const ReplyStore::Entry* entry = chunk.index ? nullptr : stored_.find(whole, ms_);
  if (entry != nullptr) {
    memcpy(body(), entry->reply, entry->reply_size);
    answer(whole, entry->status, entry->reply_size);
    ++stats_.repeats;
  }
  pass_over();
}

void Board::begin_message(const Chunk& chunk) {
  switch (chunk.cmd) {
    case gen::CMD_TRAJECTORY_POINTS:
      return begin_points(chunk);
    case gen::CMD_SERVO_TABLE:
      return begin_table(chunk);
    default:
      return refuse(gen::STATUS_NOT_SUPPORTED);
  }
}

void Board::use_chunk(const Chunk& chunk) {
  if (!inbox_.right_size(chunk)) return end_message(gen::STATUS_BAD_LENGTH);
  if (chunk.cmd == gen::CMD_SERVO_TABLE) return use_table(chunk);
  use_points(chunk.data, chunk.size, chunk.size);
}

void Board::begin_points(const Chunk& chunk) {
  const uint8_t* p = chunk.data;
  if (chunk.size < gen::TRAJECTORY_POINTS_REQUEST_SIZE) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t last = p[gen::TRAJECTORY_POINTS_REQUEST_LAST];
  if (p[gen::TRAJECTORY_POINTS_REQUEST_ID] != trajectory_.id() || last > 1) return refuse(gen::STATUS_BAD_RANGE);
  if (stopped()) return refuse(gen::STATUS_STOPPED);
  const uint8_t count = p[gen::TRAJECTORY_POINTS_REQUEST_COUNT];
  const uint16_t whole = static_cast<uint16_t>(gen::TRAJECTORY_POINTS_REQUEST_SIZE + count * trajectory_.stride());
  if (count == 0 || !inbox_.begin(chunk, whole, ms_)) return refuse(gen::STATUS_BAD_LENGTH);
  const uint8_t status = trajectory_.stage(get16(p + gen::TRAJECTORY_POINTS_REQUEST_FIRST), count, last);
  if (status != gen::STATUS_OK) return end_message(status);
  use_points(p + gen::TRAJECTORY_POINTS_REQUEST_POINTS,
             static_cast<uint8_t>(chunk.size - gen::TRAJECTORY_POINTS_REQUEST_SIZE), chunk.size);
}

void Board::use_points(const uint8_t* points, uint8_t size, uint8_t of_chunk) {
  const uint8_t status = trajectory_.take(points, size);
  if (status != gen::STATUS_OK) return end_message(status);
  if (!chunk_used(of_chunk)) return pass_over();
  trajectory_.commit();
  reply_path_status();
}

// Goes on after a chunk; true if it was the last one.
bool Board::chunk_used(uint8_t size) {
  inbox_.used(size, ms_);
  if (!inbox_.complete()) {
    if (inbox_.must_ask()) ask_on();
    return false;
  }
  inbox_.finish();
  ask_for(inbox_.src(), inbox_.id(), 0, 0);
  return true;
}

// Refuses the message under way.
void Board::end_message(uint8_t status) {
  drop_message();
  refuse(status);
}

void Board::drop_message() {
  if (!inbox_.open()) return;
  inbox_.close();
  trajectory_.drop_staged();
}

// A restarted host may use its numbers again.
void Board::forget_messages(int32_t src) {
  if (inbox_.src() == src) {
    drop_message();
    inbox_.close();
  }
  outbox_.forget(src);
}

// A stop has come.
void Board::void_messages() {
  outbox_.close();
  if (!inbox_.open()) return;
  drop_message();
  void_message(inbox_.src(), inbox_.seq(), inbox_.cmd());
}

// Voids a message, of which several chunks may wait.
void Board::void_message(int32_t src, uint8_t seq, uint8_t cmd) {
  const Request request = {src, gen::PROTO_HEXWIRE, seq, cmd, 0, tx_};
  if (!is_void(request)) void_request(request);
}

// Time-outs of messages; called in every pass.
void Board::watch_messages() {
  // Not while a chunk is used or made.
  if (job_.active && job_.program == kTable) return;
  if (inbox_.expired(ms_)) drop_message();
  if (outbox_.expired(ms_)) outbox_.close();
  if (inbox_.should_ask_again(ms_) && may_send()) ask_on();
}

}  // namespace hexwire
