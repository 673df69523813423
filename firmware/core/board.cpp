#include "hot.h"  // first

#include "board.h"

#include <string.h>

#include "address.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint32_t kSecondUs = 1000000;
constexpr uint16_t kChapterMs = 1000;
// A report is made when the previous one is almost sent, so that its samples are fresh.
constexpr uint8_t kReportBacklog = 24;

bool is_stop(const Frame& frame) {
  return frame.cmd == gen::CMD_STOP && frame.size == gen::STOP_REQUEST_SIZE && frame.body[0] < kStopModes;
}

}  // namespace

Board::Board(Platform& platform)
    : platform_(platform),
      rate_(platform),
      stats_(),
      decoder_(stats_),
      queue_(),
      stored_(),
      stops_(),
      voided_(),
      void_left_(0),
      settings_(platform),
      bus_(platform, stats_),
      joints_(),
      gate_(joints_, settings_),
      raw_(),
      poller_(bus_, joints_, raw_),
      sweep_(bus_, joints_, raw_),
      job_(),
      trajectory_(settings_),
      path_(),
      owner_(Owner::kNobody),
      next_owner_(Owner::kNobody),
      now_running_(),
      boot_id_(0),
      board_flags_(0),
      outputs_(0),
      last_us_(0),
      us_(0),
      sec_(0),
      ms_(0),
      ms_rest_(0),
      sn_(0),
      report_seq_(0),
      report_fields_(0),
      report_to_(0),
      heard_ms_(0),
      chapter_heard_(false),
      chapter_heard_ms_(0),
      fed_(false),
      watchdog_mode_(0),
      watchdog_ms_(0) {}

void Board::begin(uint32_t boot_id, uint8_t reset_flags) {
  boot_id_ = boot_id;
  board_flags_ = reset_flags;
  last_us_ = platform_.micros();
  settings_.load();
  platform_.set_outputs(0);
  start_job(kBoot, kAllJoints);
  job_.owner = For::kBoot;
}

void Board::tick() {
  const uint32_t now = platform_.micros();
  const uint32_t passed = now - last_us_;
  last_us_ = now;
  us_ += passed;
  while (us_ >= kSecondUs) {
    us_ -= kSecondUs;
    ++sec_;
  }
  uint32_t rest = passed + ms_rest_;
  while (rest >= 1000) {
    // A pass is short; only a debugger or a test makes this loop long.
    const uint32_t whole = rest >= kSecondUs ? rest / 1000 : 1;
    ms_ += whole;
    rest -= whole * 1000;
  }
  ms_rest_ = static_cast<uint16_t>(rest);
  voided_.age(ms_);
  if (chapter_heard_ && ms_ - chapter_heard_ms_ > kChapterMs) chapter_heard_ = false;
}

bool Board::poll() {
  // The servo line first: it should not wait for anything else.
  tick();
  const uint32_t begun = last_us_;
  run_bus();
  report();
  receive();
  check_rate();
  check_watchdog();
  settings_.poll();
  run_bus();
  void_next();
  answer_stops();
  const uint32_t took = platform_.micros() - begun;
  if (took > stats_.loop_us_max) stats_.loop_us_max = took;
  return void_left_ == 0 && (queue_.count() == 0 || owner_ != Owner::kNobody);
}

void Board::receive() {
  do {
    const uint8_t room = decoder_.room();
    if (room) decoder_.added(static_cast<uint8_t>(platform_.host_read(decoder_.space(), room)), last_us_);
    Frame frame;
    while (decoder_.next(frame)) accept(frame);
  } while (decoder_.expire(last_us_));
  platform_.host_expect(decoder_.missing());
}

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

void Board::check_rate() {
  if (rate_.poll(ms_)) decoder_.forget();
}

void Board::check_watchdog() {
  if (watchdog_ms_ == 0 || !fed_ || ms_ - heard_ms_ < watchdog_ms_) return;
  if (trajectory_.outlives_host()) return;
  fed_ = false;
  ++stats_.watchdog_trips;
  board_flags_ |= gen::BOARD_FLAG_WATCHDOG_TRIPPED;
  stop(watchdog_mode_);
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

void Board::report() {
  if (platform_.host_write_waiting() > kReportBacklog) return;
  if (!poller_.take_report(last_us_)) return;
  const uint8_t size = put_state(report_fields_);
  send(gen::PROTO_HEXWIRE, report_to_, report_seq_++, gen::CMD_JOINT_STATE, gen::EXT_UNSOLICITED, size);
}

}  // namespace hexwire
