#include "hot.h"  // first

#include "servo_bus.h"

#include <string.h>

#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint8_t kStatusOverhead = 6;      // FF FF id len error ... chk
constexpr uint8_t kIdAt = 2;
constexpr uint8_t kFirstSyncId = 7;
constexpr uint16_t kQuietUs = 250;          // a line counts as quiet after this
constexpr uint16_t kMaxQuietWaitUs = 3000;  // longest time that a babbling servo delays the others
constexpr uint16_t kGapUs = 1500;           // silence inside an answer, or between two of them
constexpr uint16_t kHurryUs = 1000;
constexpr uint16_t kMaxHurryUs = 4000;
constexpr uint16_t kMarginUs = 3000;
constexpr uint8_t kMostLooks = 30;          // for the last byte of an answer

}  // namespace

ServoBus::ServoBus(Platform& platform, Stats& stats)
    : ServoBusFields(), platform_(platform), stats_(stats), packet_(packets_), made_(packets_) {
  result_ = BusResult::kSilent;
  line_dirty_ = true;
  echo_over_ = true;
}

void ServoBus::begin(uint8_t id, uint8_t instruction) {
  prepared_ = false;
  made_ = state_ != State::kIdle && packet_ == packets_ ? packets_ + kMostPrepared : packets_;
  made_[0] = 0xFF;
  made_[1] = 0xFF;
  made_[2] = id;
  made_[4] = instruction;
  made_size_ = 5;
  whole_ = false;
}

void ServoBus::add16(uint16_t value, bool big_endian) {
  if (big_endian) {
    put16_big(made_ + made_size_, value);
  } else {
    put16(made_ + made_size_, value);
  }
  made_size_ = static_cast<uint8_t>(made_size_ + 2);
}

void ServoBus::take(const uint8_t* packet, uint8_t size) {
  prepared_ = false;
  made_ = packets_;
  memcpy(made_, packet, size);
  made_size_ = size;
  whole_ = true;
}

void ServoBus::close_packet() {
  made_[3] = static_cast<uint8_t>(made_size_ - 3);
  made_[made_size_] = servo_checksum(made_ + 2, static_cast<uint8_t>(made_size_ - 2));
  ++made_size_;
}

void ServoBus::start_silent() { start(Kind::kSilent, 0, Expect{kAnyHeader, 0, false, 1, 0}); }

void ServoBus::start_single(const Expect& expect) { start(Kind::kPackets, 1, expect); }

void ServoBus::start_many(uint8_t count, const Expect& expect) { start(Kind::kPackets, count, expect); }

void ServoBus::start_raw(uint8_t reply_length, uint32_t timeout_us) {
  raw_length_ = reply_length;
  start(reply_length ? Kind::kRaw : Kind::kSilent, 0, Expect{kAnyHeader, 0, false, 1, 0});
  timeout_us_ = timeout_us;
}

void ServoBus::start(Kind kind, uint8_t wanted, const Expect& expect) {
  if (!whole_) close_packet();
  next_.kind = kind;
  next_.size = made_size_;
  next_.wanted = wanted;
  next_.answer = answer_bytes(kind, wanted, expect);
  next_.expect = expect;
  prepared_ = true;
  if (state_ != State::kIdle) return;
  launch();
  follow();
}

uint8_t ServoBus::answer_bytes(Kind kind, uint8_t wanted, const Expect& expect) const {
  if (kind == Kind::kRaw) return raw_length_;
  if (kind == Kind::kSilent) return 0;
  const uint8_t parameters = expect.parameters == kAnyLength ? 0 : expect.parameters;
  return static_cast<uint8_t>(wanted * (parameters + kStatusOverhead));
}

bool ServoBus::launch() {
  if (drop_input()) line_dirty_ = true;
  if (line_dirty_) return false;
  platform_.bus_write(made_, next_.size);
  return true;
}

// Everything else can be done while the packet is being sent.
void ServoBus::follow() {
  prepared_ = false;
  packet_ = made_;
  size_ = next_.size;
  kind_ = next_.kind;
  wanted_ = next_.wanted;
  whole_answer_ = next_.answer;
  expect_ = next_.expect;
  timeout_us_ = expect_.timeout_us;
  tries_left_ = expect_.tries;
  hurried_ = false;
  if (line_dirty_) return wait_for_quiet();
  note_sent();
}

// Bytes on the line now belong to no request: a late answer must not be taken for the next one. True if there are any.
bool ServoBus::drop_input() {
  uint8_t scrap[4];
  bool any = false;
  uint8_t count;
  while ((count = platform_.bus_read(scrap, sizeof(scrap))) != 0) {
    stats_.bytes_dropped += count;
    any = true;
  }
  return any;
}

void ServoBus::wait_for_quiet() {
  state_ = State::kQuiet;
  since_ = last_rx_ = now_;
}

void ServoBus::send() {
  platform_.bus_write(packet_, size_);
  note_sent();
}

// What a request that is on the line begins.
void ServoBus::note_sent() {
  state_ = State::kSending;
  --tries_left_;
  ++stats_.bus_transactions;
  received_ = searched_ = got_ = half_size_ = 0;
  memset(at_, kNoAnswer, wanted_);
  echo_matched_ = 0;
  echo_over_ = false;
  line_dirty_ = false;
  // All but the last byte, so that they are processed before it arrives.
  const uint8_t bytes = whole_answer_ ? static_cast<uint8_t>(whole_answer_ - 1) : 0;
  platform_.bus_expect(echo_seen_ ? static_cast<uint8_t>(bytes + size_) : bytes);
}

void ServoBus::poll(uint32_t now) {
  now_ = now;
  switch (state_) {
    case State::kIdle:
    case State::kFinished:
      return;
    case State::kQuiet:
      if (drop_input()) last_rx_ = now;
      if (now - last_rx_ >= kQuietUs || now - since_ >= kMaxQuietWaitUs) send();
      return;
    case State::kSending:
    case State::kWaiting:
      receive();
      return;
  }
}

void ServoBus::receive() {
  const bool sending = platform_.bus_sending();
  const uint32_t now = now_;
  if (state_ == State::kSending && !sending) {
    state_ = State::kWaiting;
    since_ = last_rx_ = now;
  }
  uint8_t chunk[16];
  uint8_t count;
  while ((count = platform_.bus_read(chunk, sizeof(chunk))) != 0) {
    last_rx_ = now;
    for (uint8_t i = 0; i < count; ++i) take_byte(chunk[i], sending);
    if (state_ != State::kWaiting) continue;
    search();
    if (complete()) return finish(BusResult::kOk);
  }
  if (state_ == State::kWaiting) check_end();
}

// Ends a transaction that waits for nothing, or has waited long enough.
void ServoBus::check_end() {
  const uint32_t waited = now_ - since_;
  if (kind_ == Kind::kSilent) {
    // The echo, if there is one, ends with the stop bit; one byte later the line is free.
    if (waited >= kByteUs || !echo_seen_) finish(BusResult::kOk);
    return;
  }
  const uint32_t quiet = now_ - last_rx_;
  if (hurried_ && (quiet >= kHurryUs || now_ - hurried_at_ >= kMaxHurryUs)) return fail();
  const uint32_t answer_us = static_cast<uint32_t>(kMaxAnswer) * kByteUs;
  if ((waited >= timeout_us_ && quiet >= kGapUs) || waited >= timeout_us_ + answer_us + kMarginUs) fail();
}

void ServoBus::take_byte(uint8_t byte, bool during_send) {
  if (!echo_over_) {
    if (byte == packet_[echo_matched_]) {
      if (++echo_matched_ == size_) echo_over_ = true;
      return;
    }
    echo_over_ = true;
    if (!during_send) {
      // There is no echo: what looked like its beginning belongs to the answer.
      received_ = echo_matched_ < sizeof(answer_) ? echo_matched_ : sizeof(answer_);
      memcpy(answer_, packet_, received_);
      echo_matched_ = 0;
    }
  }
  // No servo can answer while the board is sending: such bytes are noise.
  if (during_send) {
    ++stats_.bytes_dropped;
    return;
  }
  if (kind_ == Kind::kSilent) return;
  if (received_ < sizeof(answer_)) {
    answer_[received_++] = byte;
  } else {
    ++stats_.bytes_dropped;
  }
}

bool ServoBus::complete() const {
  if (kind_ == Kind::kRaw) return received_ >= raw_length_;
  return kind_ == Kind::kPackets && got_ == wanted_;
}

void ServoBus::search() {
  if (kind_ != Kind::kPackets) return;
  while (searched_ + 4 <= received_) {
    if (!match_at(searched_)) return;
  }
}

// Examines the packet that begins at `at`; false if more bytes are needed to decide.
bool ServoBus::match_at(uint8_t at) {
  const uint8_t* p = answer_ + at;
  if (half_size_ == 0) {
    half_index_ = right_header(p) ? awaited(p[2]) : wanted_;
    if (half_index_ < wanted_ && right_length(p[3])) {
      half_size_ = expect_.ping ? kStatusOverhead : static_cast<uint8_t>(p[3] + 4);
    }
  }
  const uint8_t size = half_size_;
  if (received_ - at < size) return false;
  if (size && p[size - 1] == servo_checksum(p + 2, static_cast<uint8_t>(size - 3))) {
    take_half();
  } else {
    half_size_ = 0;
    searched_ = static_cast<uint8_t>(at + 1);
  }
  return true;
}

// The packet whose beginning was found is complete.
void ServoBus::take_half() {
  at_[half_index_] = searched_;
  ++got_;
  searched_ = static_cast<uint8_t>(searched_ + half_size_);
  half_size_ = 0;
}

void ServoBus::await_end() {
  if (half_size_ == 0 || received_ + 1 != searched_ + half_size_) return;
  // The last byte is the checksum, so what it must be is known.
  const uint8_t check = servo_checksum(answer_ + searched_ + 2, static_cast<uint8_t>(half_size_ - 3));
  for (uint8_t n = 0; n < kMostLooks; ++n) {
    if (platform_.bus_read(answer_ + received_, 1) == 0) continue;
    const bool right = answer_[received_++] == check;
    if (right) take_half();
    if (right && complete()) finish(BusResult::kOk);
    return;
  }
}

bool ServoBus::right_header(const uint8_t* p) const {
  if (p[0] != 0xFF) return false;
  return expect_.header == kAnyHeader ? p[1] == 0xFF || p[1] == 0xF5 : p[1] == expect_.header;
}

// Place of a servo whose answer is still missing; `wanted_` if there is none.
uint8_t ServoBus::awaited(uint8_t id) const {
  uint8_t index = 0;
  const uint8_t* ids = packet_ + (packet_[4] == gen::INST_SYNC_READ ? kFirstSyncId : kIdAt);
  while (index < wanted_ && (at_[index] != kNoAnswer || (ids[index] != id && ids[index] != gen::BROADCAST_ID))) {
    ++index;
  }
  return index;
}

bool ServoBus::right_length(uint8_t length) const {
  if (expect_.ping) return true;
  if (expect_.parameters == kAnyLength) return length >= 2 && length <= sizeof(answer_) - 4;
  return length == expect_.parameters + 2;
}

void ServoBus::fail() {
  if (only_an_echo() && !echo_seen_ && kind_ != Kind::kSilent) {
    // An answer may equal its request byte for byte (for example, of a ping with error bit 0 set). On a line that is
    // known not to echo, what was taken for the echo is then the answer.
    received_ = size_ < sizeof(answer_) ? size_ : sizeof(answer_);
    memcpy(answer_, packet_, received_);
    echo_matched_ = 0;
    search();
    if (complete()) return finish(BusResult::kOk);
  }
  line_dirty_ = true;
  const bool nothing = received_ == 0;
  ++(nothing ? stats_.bus_timeouts : stats_.bus_bad);
  if (tries_left_ && got_ == 0 && !hurried_) {
    ++stats_.bus_retries;
    return wait_for_quiet();
  }
  finish(nothing ? BusResult::kSilent : BusResult::kDamaged);
}

void ServoBus::finish(BusResult result) {
  if (result == BusResult::kOk && kind_ != Kind::kSilent) echo_seen_ = echo_over_ && echo_matched_ == size_;
  result_ = result;
  state_ = State::kFinished;
}

bool ServoBus::finished() {
  if (state_ != State::kFinished) return false;
  state_ = State::kIdle;
  return true;
}

void ServoBus::hurry(uint32_t now) {
  hurried_ = true;
  hurried_at_ = now;
  if (state_ == State::kQuiet) finish(BusResult::kSilent);
}

const uint8_t* ServoBus::answer(uint8_t index) const {
  if (kind_ == Kind::kRaw) return answer_;
  if (kind_ == Kind::kSilent) return nullptr;
  return at_[index] == kNoAnswer ? nullptr : answer_ + at_[index];
}

uint8_t ServoBus::answer_size(uint8_t index) const {
  if (kind_ == Kind::kRaw) return received_;
  return expect_.ping ? kStatusOverhead : static_cast<uint8_t>(answer_[at_[index] + 3] + 4);
}

}  // namespace hexwire
