// What a stop does: it voids waiting requests, stops the servos, and checks that they stopped. See PROTOCOL.md,
// sections 6.3 (STOP) and 6.5.
#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint8_t kStill = 4;          // most counts between two samples of a joint that holds
constexpr uint16_t kSettleMs = 400;

bool near(int16_t a, int16_t b) {
  const int32_t difference = static_cast<int32_t>(a) - b;
  return difference <= kStill && difference >= -kStill;
}

}  // namespace

void VoidedStore::put(const Request& request, uint32_t now_ms, uint8_t state) {
  entries_[next_] = Entry{state, request.seq, request.cmd, static_cast<uint8_t>(request.src), hash(request),
                          static_cast<uint16_t>(now_ms)};
  next_ = static_cast<uint8_t>((next_ + 1) % kMost);
}

uint16_t VoidedStore::hash(const Request& request) {
  uint8_t src[4];
  put32(src, static_cast<uint32_t>(request.src));
  return crc16(request.body, request.size, crc16(src, sizeof(src)));
}

void Board::stop(uint8_t mode) {
  board_flags_ |= gen::BOARD_FLAG_STOPPED;
  if (mode) board_flags_ |= gen::BOARD_FLAG_TORQUE_OFF_STOP;
  end_maintenance();
  stops_.want(mode);
  voided_.stop();
  end_path();
  void_messages();
  void_left_ = queue_.count();
  // A stop under way in this mode, or in a stronger one, is not restarted, however many requests arrive.
  if (job_.active && job_.owner == For::kStop && job_.argument >= mode) return;
  drop_job();
  if (!bus_.idle()) bus_.hurry(last_us_);
}

// Starts the stop whose turn it is; false if there is none.
bool Board::start_stop() {
  if (!stops_.wanted(0) && !stops_.wanted(1)) return false;
  const uint8_t mode = stops_.wanted(1) ? 1 : 0;
  start_job(mode ? kTorqueOff : kHold, kAllJoints);
  job_.owner = For::kStop;
  job_.argument = mode;
  return true;
}

// Answers one request that a stop has voided, if there is room beside the stop's own answer, and forgets it.
void Board::void_next() {
  if (void_left_ == 0) return;
  // The servos first: no answer is made while the stop waits for the servo line.
  if (job_.active && job_.owner == For::kStop && owner_ != Owner::kJob && needs_bus()) return;
  --void_left_;
  Request request;
  queue_.front(&request);
  if (request.proto == gen::PROTO_HEXWIRE) {
    if (request.cmd != gen::CMD_FRAGMENT_MISSING) void_request(request);
    return queue_.pop();
  }
  const bool room = platform_.host_write_room() >= 2 * kStopAnswer;
  if (room && request.cmd != gen::CMD_SYNC_WRITE) send_chapter(silent_servo(request));
  queue_.pop();
}

// Remembers a request that a stop has voided, and answers it if there is room beside the stop's own answer.
void Board::void_request(const Request& request) {
  if (request.cmd == gen::CMD_FRAGMENT && request.size >= gen::FRAGMENT_REQUEST_SIZE) {
    const Chunk chunk = Chunk::parse(request.src, request.body, request.size);
    return void_message(chunk.src, chunk.seq(), chunk.cmd);
  }
  if (request.cmd != gen::CMD_IDENTIFY) voided_.add(request, ms_);
  if (platform_.host_write_room() < 2 * kStopAnswer) return;
  send(gen::PROTO_HEXWIRE, request.src, request.seq, request.cmd, gen::EXT_REPLY | gen::STATUS_STOPPED, 0);
}

void Board::answer_stops() {
  if (rate_.changing()) return;
  StopList::Asker asker;
  StopList::Outcome outcome;
  while (platform_.host_write_room() >= kStopAnswer && stops_.take_done(&asker, &outcome)) {
    body()[gen::STOP_REPLY_MODE] = asker.mode;
    put16(body() + gen::STOP_REPLY_MASK, outcome.mask);
    const Request request = {asker.src, gen::PROTO_HEXWIRE, asker.seq, gen::CMD_STOP, gen::STOP_REQUEST_SIZE, &asker.mode};
    stored_.add(request, outcome.status, body(), gen::STOP_REPLY_SIZE, ms_);
    send(gen::PROTO_HEXWIRE, asker.src, asker.seq, gen::CMD_STOP, gen::EXT_REPLY | outcome.status, gen::STOP_REPLY_SIZE);
  }
}

void Board::finish_stop(uint8_t status, Mask confirmed) {
  job_.active = false;
  stops_.done(job_.argument, status, confirmed);
}

// A joint without torque gets no target, which could switch its torque on.
void Board::aim_hold() {
  Mask mask = torqued();
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!joints_[i].torque_known) mask &= static_cast<Mask>(~only(i));
  }
  aim(mask);
}

// Puts the packet that switches torque off into the send buffer; false if no joint is named.
bool Board::take_torque(Mask mask) {
  // The result of an earlier read must not be used after this packet.
  poller_.digest();
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(mask & only(i))) continue;
    joints_[i].torque_on = false;
    joints_[i].torque_known = false;
  }
  return joints_.make_torque(bus_, mask, false);
}

// Does the same to joints that cannot be held.
bool Board::take_back(Mask mask) {
  const bool any = take_torque(mask);
  job_.taken |= mask;
  job_.targets.mask &= static_cast<Mask>(~job_.taken);
  return any;
}

Mask Board::in_other_mode() const {
  Mask mask = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (joints_[i].torque_on && joints_.other_mode(i)) mask |= only(i);
  }
  return mask;
}

void Board::check_torque() {
  bool again = false;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(sweep_.answered() & only(i))) continue;
    const int16_t value = sweep_.value(i);
    if (value == 0) {
      job_.limp |= only(i);
      job_.targets.mask &= static_cast<Mask>(~only(i));
    } else if (value != 1) {
      // Damped: neither limp nor held.
      job_.bad |= only(i);
    } else if (!(job_.targets.mask & only(i))) {
      again = true;
    }
  }
  if (again && try_again()) return begin_again();
  next_step();
}

void Board::check_target() {
  Mask wrong = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(job_.targets.mask & only(i))) continue;
    if (!(sweep_.answered() & only(i)) || joints_.mode_unknown(i)) {
      job_.targets.mask &= static_cast<Mask>(~only(i));
    } else if (sweep_.value(i) != job_.targets.position[i]) {
      wrong |= only(i);
    }
  }
  // A servo is present but did not get the packet: noise may destroy a packet that has no answer.
  if (wrong && try_again()) return begin_again();
  job_.bad |= wrong;
  job_.moving = job_.targets.mask & static_cast<Mask>(~job_.bad);
  job_.settle_ms = ms_;
  next_step();
}

void Board::note_positions() {
  job_.noted_ms = ms_;
  for (uint8_t i = 0; i < kJoints; ++i) job_.noted[i] = joints_[i].position;
}

// Whether a joint with torque is elsewhere than noted.
bool Board::moved_since_note() const {
  for (uint8_t i = 0; i < kJoints; ++i) {
    const bool read = sweep_.answered() & only(i);
    if (read && joints_[i].torque_on && !near(joints_[i].position, job_.noted[i])) return true;
  }
  return false;
}

void Board::check_still() {
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(job_.moving & only(i))) continue;
    const bool silent = !(sweep_.answered() & only(i));
    if (silent) job_.targets.mask &= static_cast<Mask>(~only(i));
    if (silent || near(joints_[i].position, job_.noted[i])) job_.moving &= static_cast<Mask>(~only(i));
  }
  if (job_.moving && ms_ - job_.settle_ms < kSettleMs) return back_to(Step::kNote);
  next_step();
}

void Board::finish_hold() {
  Mask off = 0;
  job_.bad = job_.moving = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(job_.taken & sweep_.answered() & only(i))) continue;
    (sweep_.value(i) == 0 ? off : job_.bad) |= only(i);
  }
  if (job_.bad && try_again()) return back_to(Step::kTakeRest);
  if (job_.owner == For::kBoot) {
    job_.active = false;
    return;
  }
  const Mask confirmed = job_.targets.mask | job_.limp | off;
  const bool all = confirmed == job_.mask;
  finish_stop(!all ? gen::STATUS_SERVO_SILENT : job_.taken ? gen::STATUS_SERVO_FAULT : gen::STATUS_OK, confirmed);
}

}  // namespace hexwire
