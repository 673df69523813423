#include "hot.h"  // first

#include "board.h"

namespace hexwire {

namespace {

constexpr uint32_t kSecondUs = 1000000;
constexpr uint16_t kChapterMs = 1000;
// A report is made when the previous one is almost sent, so that its samples are fresh.
constexpr uint8_t kReportBacklog = 24;

}  // namespace

Board::Board(Platform& platform)
    : BoardFields(),
      platform_(platform),
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
      inbox_(),
      outbox_(),
      table_(),
      sent_table_(),
      received_table_(),
      owner_(Owner::kNobody),
      next_owner_(Owner::kNobody),
      now_running_() {}

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
  watch_messages();
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

void Board::report() {
  if (platform_.host_write_waiting() > kReportBacklog) return;
  if (!poller_.take_report(last_us_)) return;
  const uint8_t size = put_state(report_fields_);
  send(gen::PROTO_HEXWIRE, report_to_, report_seq_++, gen::CMD_JOINT_STATE, gen::EXT_UNSOLICITED, size);
}

}  // namespace hexwire
