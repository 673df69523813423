// Frames of hosts, in and out: which are repeats, stops, or for others, and how they are answered. See PROTOCOL.md,
// sections 5 and 6.
#include <string.h>

#include "address.h"
#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

bool is_stop(const Frame& frame) {
  return frame.cmd == gen::CMD_STOP && frame.size == gen::STOP_REQUEST_SIZE && frame.body[0] < kStopModes;
}

}  // namespace

void Board::accept(const Frame& frame) {
  const bool chapter = frame.proto != gen::PROTO_HEXWIRE;
  if (chapter) {
    chapter_heard_ = true;
    chapter_heard_ms_ = ms_;
  } else {
    if (names_board(frame.dst) == Named::kNo) return;
    if (frame.ext & (gen::EXT_REPLY | gen::EXT_UNSOLICITED)) return;
  }
  note_life(frame, chapter);
  if (!chapter && (is_repeat(frame) || refuse_for_several(frame) || accept_stop(frame))) return;
  if (queue_.push(frame)) {
    if (queue_.count() > stats_.queue_high_water) stats_.queue_high_water = queue_.count();
  } else if (!chapter) {
    voided_.add_done(request_of(frame), ms_);
    answer(frame, gen::STATUS_BUSY, 0);
  }
}

// A valid frame feeds the watchdog. HOST_BAUD does not: it shows that the line works, not that a program is in control.
void Board::note_life(const Frame& frame, bool chapter) {
  rate_.heard(ms_);
  if (!chapter && frame.cmd == gen::CMD_HOST_BAUD) return;
  heard_ms_ = ms_;
  fed_ = true;
}

// Whether a request came before. It is answered as then, or the answer is still to come.
bool Board::is_repeat(const Frame& frame) {
  if (frame.cmd == gen::CMD_IDENTIFY) {
    stored_.forget(frame.src);
    voided_.forget(frame.src);
    forget_messages(frame.src);
  }
  // The rate may have gone back since, so that a stored answer would be wrong.
  const ReplyStore::Entry* entry = frame.cmd == gen::CMD_HOST_BAUD ? nullptr : stored_.find(frame, ms_);
  if (entry != nullptr) {
    memcpy(body(), entry->reply, entry->reply_size);
    answer(frame, entry->status, entry->reply_size);
  } else if (voided_.holds(frame, ms_)) {
    answer(frame, gen::STATUS_STOPPED, 0);
  } else if (!queue_.holds(frame) && !(is_stop(frame) && stops_.holds(frame.src, frame.seq, frame.body[0]))) {
    return false;
  }
  ++stats_.repeats;
  return true;
}

// Refuses a command that must go to one module.
bool Board::refuse_for_several(const Frame& frame) {
  if (names_board(frame.dst) == Named::kAlone || goes_to_several(frame.cmd)) return false;
  answer(frame, gen::STATUS_NOT_SUPPORTED, 0);
  return true;
}

// Obeys a valid STOP at once.
bool Board::accept_stop(const Frame& frame) {
  if (!is_stop(frame)) return false;
  const bool room = stops_.add(frame.src, frame.seq, frame.body[0]);
  stop(frame.body[0]);
  if (!room) answer(frame, gen::STATUS_BUSY, 0);
  return true;
}

// Answers a frame of dialect 2 that is not executed.
void Board::answer(const Frame& frame, uint8_t status, uint8_t size) {
  send(gen::PROTO_HEXWIRE, frame.src, frame.seq, frame.cmd, gen::EXT_REPLY | status, size);
}

void Board::send(uint8_t proto, int32_t dst, uint8_t seq, uint8_t cmd, uint8_t ext, uint8_t size) {
  FrameHead head;
  head.time_sec = sec_;
  head.time_nsec = us_ * 1000;
  head.sn = sn_ + 1;
  head.src = gen::MODULE_ARM_7BOT_ARDUINO_TRX;
  head.dst = dst;
  head.proto = proto;
  head.seq = seq;
  head.cmd = cmd;
  head.ext = ext;
  const uint8_t whole = finish_frame(tx_, head, size);
  // Jobs start only if there is room for their answer. Other answers are lost if there is no room; the host retries.
  if (rate_.changing() || platform_.host_write_room() < whole) return;
  platform_.host_write(tx_, whole);
  ++sn_;
  ++stats_.frames_sent;
}

void Board::reply(uint8_t status, uint8_t size) {
  job_.active = false;
  if (now_running_.proto == gen::PROTO_HEXWIRE) {
    const Request& request = now_running_;
    stored_.add(request, status, body(), size, ms_);
    voided_.add_done(request, ms_);
    send(gen::PROTO_HEXWIRE, request.src, request.seq, request.cmd, gen::EXT_REPLY | status, size);
  }
  queue_.pop();
}

void Board::reply_chapter(uint8_t size) {
  job_.active = false;
  send_chapter(size);
  queue_.pop();
}

// The chapter's board counts its replies and always sends command 02 to module 0.
void Board::send_chapter(uint8_t size) {
  send(gen::PROTO_CHAPTER, gen::MODULE_ROS1_HOST, static_cast<uint8_t>(sn_ + 1), gen::CMD_READ, 0, size);
}

}  // namespace hexwire
