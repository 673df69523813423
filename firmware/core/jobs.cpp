#include "hot.h"  // first

// The commands that need more than one bus transaction, as lists of steps, and the code that runs them.
#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint8_t kMoreTries = 2;
constexpr uint8_t kPauseMs = 20;
constexpr uint8_t kRatePauseMs = 100;

// What each reading step reads, in the order of the steps.
const Item kItems[] = {Item::kPosition, Item::kPosition, Item::kTorque, Item::kTorque,   Item::kMode,
                       Item::kMode,     Item::kCeiling,  Item::kTarget, Item::kPosition, Item::kTorque};

}  // namespace

const Board::Step Board::kBoot[] = {
    Step::kReadPosition, Step::kReadTorque,  Step::kReadMode,    Step::kReadCeiling, Step::kAimHold,
    Step::kTakeOtherMode, Step::kSendLegacy, Step::kSendHls,     Step::kEndIfLimp,   Step::kReadTorque,
    Step::kCheckTorque,  Step::kReadTarget,  Step::kCheckTarget, Step::kReadMoving,  Step::kNote,
    Step::kPause,        Step::kReadMoving,  Step::kCheckStill,  Step::kTakeRest,    Step::kReadTaken,
    Step::kFinishHold};
// The targets first, as soon as possible; then the check that they took effect.
const Board::Step Board::kHold[] = {
    Step::kReadPosition, Step::kReadUnsure,    Step::kReadCeiling, Step::kAimHold,     Step::kSendLegacy,
    Step::kSendHls,      Step::kReadMode,      Step::kTakeOtherMode, Step::kReadTorque, Step::kCheckTorque,
    Step::kReadTarget,   Step::kCheckTarget,   Step::kReadMoving,  Step::kNote,        Step::kPause,
    Step::kReadMoving,   Step::kCheckStill,    Step::kTakeRest,    Step::kReadTaken,   Step::kFinishHold};
const Board::Step Board::kMove[] = {Step::kReadUnsure, Step::kReadStale,  Step::kReadCeiling, Step::kAimMove,
                                    Step::kSendLegacy, Step::kSendHls,    Step::kReplyMove};
const Board::Step Board::kSyncWrite[] = {Step::kReadUnknownMode, Step::kReadUnsure, Step::kReadStale,
                                         Step::kReadCeiling,     Step::kAimSyncWrite, Step::kSendLegacy,
                                         Step::kSendHls,         Step::kReplySyncWrite};
const Board::Step Board::kTorqueOn[] = {Step::kReadPosition, Step::kReadMode, Step::kReadCeiling,
                                        Step::kAimPresent,   Step::kSendLegacy, Step::kSendHls,
                                        Step::kSendTorque,   Step::kReadTorque, Step::kConfirmTorque};
const Board::Step Board::kTorqueOff[] = {Step::kSendTorque, Step::kReadTorque, Step::kConfirmTorque};
const Board::Step Board::kPass[] = {Step::kSendPacket, Step::kReplyPacket};
const Board::Step Board::kSteer[] = {Step::kReadUnknownMode, Step::kReadUnsure,       Step::kReadStale,
                                     Step::kReadCeiling,     Step::kJudgePacket,      Step::kSendPacketLegacy,
                                     Step::kSendPacketHls,   Step::kReplyPacket};
const Board::Step Board::kGrant[] = {Step::kReadUnknownMode, Step::kReadPosition, Step::kReadCeiling,
                                     Step::kJudgePacket,     Step::kAimPresent,   Step::kSendLegacy,
                                     Step::kSendHls,         Step::kSendPacket,   Step::kReplyPacket};
const Board::Step Board::kState[] = {Step::kAwaitCycle, Step::kReplyState};
const Board::Step Board::kLater[] = {Step::kAwaitStorage};
const Board::Step Board::kSave[] = {Step::kAwaitSaved};
const Board::Step Board::kStartPath[] = {Step::kReadUnknownMode, Step::kReadUnsure, Step::kReadStale,
                                         Step::kReadCeiling, Step::kSetPathStart};
const Board::Step Board::kToRate[] = {Step::kReadUnsure, Step::kReadPosition, Step::kNote,
                                      Step::kPause,      Step::kReadPosition, Step::kChangeRate};
const Board::Step Board::kTable[] = {Step::kAskTable, Step::kTakeTable, Step::kReplyTable};
const Board::Step Board::kToMaintenance[] = {Step::kReadTorque, Step::kMaintain};

void Board::start_job(const Step* program, Mask mask) {
  job_.active = true;
  job_.owner = For::kRequest;
  job_.repeats = 0;
  job_.program = program;
  job_.mask = mask;
  job_.taken = 0;
  begin_again();
}

void Board::begin_again() {
  job_.pc = 0;
  job_.entered = false;
  job_.targets.mask = 0;
  job_.limp = job_.bad = job_.moving = 0;
}

// Whether a job that did not have its effect may have another attempt; counts it.
bool Board::try_again() {
  if (job_.repeats == kMoreTries) return false;
  ++job_.repeats;
  ++stats_.bus_retries;
  return true;
}

void Board::drop_job() {
  job_.active = false;
  if (owner_ == Owner::kJob) owner_ = Owner::kNobody;
}

void Board::next_step() {
  ++job_.pc;
  job_.entered = false;
}

void Board::back_to(Step step) {
  while (job_.program[job_.pc] != step) --job_.pc;
  job_.entered = false;
}

// One pass over everything that uses the bus.
void Board::run_bus() {
  bus_.poll(last_us_);
  // If the next byte ends the answer, what follows should begin at once: all that can be is known before.
  const bool soon = bus_.ends_soon();
  const bool ready = soon && may_go_on();
  if (soon) bus_.await_end();
  if (bus_.finished()) {
    // Otherwise a request of the host may have held up this look at the line.
    if (soon) note_pause();
    take_result(ready || may_go_on());
  }
  watch_path();
  if (!job_.active) start_next();
  // Start the next transaction before computing anything: the line should not lie idle meanwhile.
  if (wants_bus()) run_job();
  if (bus_.idle() && !wants_bus()) use_idle_line();
  poller_.digest();
  run_job();
  prepare_next();
}

// The line is free, and no request needs it: targets of the trajectory, else polling.
void Board::use_idle_line() {
  if (write_path() || keeps_line_free() || path_starts_soon()) return;
  if (!poller_.start(last_us_, ms_)) return;
  owner_ = Owner::kPoller;
  path_.begun_us = platform_.micros();
}

// Gives the result of a transaction to whoever started it, and starts what is prepared.
void Board::take_result(bool may_go_on) {
  const Owner owner = owner_;
  const bool go_on = may_go_on && launch_prepared();
  owner_ = go_on ? next_owner_ : Owner::kNobody;
  if (owner == Owner::kPoller) {
    sweep_.digest();
    poller_.take_result(last_us_, ms_);
  } else if (owner == Owner::kJob && job_.entered) {
    sweep_.take_result(last_us_, ms_);
  }
  if (go_on) went_on();
}

// Puts what is prepared on the line, if the transaction before went well.
bool Board::launch_prepared() {
  if (bus_.result() != BusResult::kOk) return false;
  if (next_owner_ == Owner::kPath && !path_goes_on()) return false;
  platform_.bus_release();
  return bus_.launch();
}

void Board::went_on() {
  bus_.follow();
  if (owner_ == Owner::kPath) return path_went_on();
  path_.begun_us = platform_.micros();
  poller_.went_on();
}

// Whether the prepared transaction may follow the one that runs: nothing else wants the line.
bool Board::may_go_on() const {
  if (!bus_.prepared() || job_.active || void_left_ || queue_.count() || !stops_.empty()) return false;
  if (keeps_line_free() || path_starts_soon()) return false;
  return next_owner_ == Owner::kPath || !path_due();
}

// Prepares what will probably follow the transaction that runs.
void Board::prepare_next() {
  if (bus_.idle() || bus_.prepared() || job_.active) return;
  if (prepare_path()) {
    next_owner_ = Owner::kPath;
  } else if (owner_ == Owner::kPoller || owner_ == Owner::kPath) {
    if (poller_.prepare(last_us_, ms_, owner_ == Owner::kPoller)) next_owner_ = Owner::kPoller;
  }
}

// While a host that speaks the chapter's dialect is sending, the line is kept free for its request.
bool Board::keeps_line_free() const { return decoder_.receiving() && (chapter_heard_ || !poller_.busy(ms_)); }

// A stop first; after it no request starts before every voided request and every stop is answered.
bool Board::start_next() {
  if (start_stop()) return true;
  if (rate_.changing()) return false;
  if (void_left_ || !stops_.empty()) return false;
  if (!queue_.front(&now_running_) || !may_send()) return false;
  execute();
  return true;
}

void Board::run_job() {
  while (job_.active ? run_step() : start_next()) {
  }
}

// The joints that a step reads.
Mask Board::asked(Step step) const {
  switch (step) {
    case Step::kReadStale:
      return stale();
    case Step::kReadUnsure:
      return lacking(Lack::kTorque);
    case Step::kReadMode:
      return job_.program == kTorqueOn ? job_.mask : torqued();
    case Step::kReadUnknownMode:
      return lacking(Lack::kMode);
    case Step::kReadCeiling:
      return lacking(Lack::kCeiling);
    case Step::kReadTarget:
      return job_.targets.mask;
    case Step::kReadMoving:
      return job_.moving;
    case Step::kReadTaken:
      return job_.taken;
    default:
      return job_.mask;
  }
}

// Whether the next step starts a transaction or needs the result of one. Other steps run during a transaction.
bool Board::needs_bus() const {
  const Step step = job_.program[job_.pc];
  if (step <= Step::kReadTaken) return job_.entered || asked(step);
  return (step >= Step::kSendLegacy && step <= Step::kAskTable) || step == Step::kReplyPacket || step == Step::kTakeTable;
}

// False if the step needs more time.
bool Board::run_step() {
  const Step step = job_.program[job_.pc];
  if (step <= Step::kReadTaken) return read_step(step);
  if (!bus_.idle() && needs_bus()) return false;
  if (step <= Step::kJudgePacket) return aim_step(step);
  if (step <= Step::kAskTable) return send_step(step);
  if (step <= Step::kEndIfLimp) return check_step(step);
  return step <= Step::kReplyState ? answer_step(step) : wait_step(step);
}

bool Board::read_step(Step step) {
  const Mask mask = asked(step);
  if (!job_.entered && mask == 0) return done();
  return bus_.idle() && sweep(kItems[static_cast<uint8_t>(step)], mask);
}

// Steps that compute targets.
bool Board::aim_step(Step step) {
  switch (step) {
    case Step::kAimPresent:
      aim(job_.mask);
      return done();
    case Step::kAimHold:
      aim_hold();
      return done();
    case Step::kAimMove:
      aim_move();
      return true;
    case Step::kAimSyncWrite:
      aim_sync_write();
      return true;
    default:
      judge_packet();
      return true;
  }
}

// Steps that send a packet; most of these packets have no answer.
bool Board::send_step(Step step) {
  switch (step) {
    case Step::kSendLegacy:
      return sent(make_targets(gen::SERIES_SEVEN_BOT));
    case Step::kSendHls:
      return sent(make_targets(gen::SERIES_HLS));
    case Step::kSendTorque:
      return sent(job_.program == kTorqueOn ? joints_.make_torque(bus_, job_.targets.mask, true)
                                            : take_torque(job_.mask));
    case Step::kSendPacket:
      next_step();
      start_packet(false);
      return false;
    case Step::kSendPacketLegacy:
      next_step();
      return !send_targets(gen::SERIES_SEVEN_BOT);
    case Step::kSendPacketHls:
      next_step();
      return !send_targets(gen::SERIES_HLS);
    case Step::kTakeOtherMode:
      return sent(take_back(in_other_mode()));
    case Step::kAskTable:
      next_step();
      ask_table();
      return false;
    default:
      return sent(take_back(job_.bad | job_.moving));
  }
}

// Steps that look at what was read.
bool Board::check_step(Step step) {
  switch (step) {
    case Step::kCheckTorque:
      check_torque();
      return true;
    case Step::kCheckTarget:
      check_target();
      return true;
    case Step::kNote:
      note_positions();
      return done();
    case Step::kPause:
      return !still_pausing() && done();
    case Step::kCheckStill:
      check_still();
      return true;
    case Step::kFinishHold:
      finish_hold();
      return true;
    default:  // kEndIfLimp
      if (job_.targets.mask || job_.taken) return done();
      job_.active = false;
      return true;
  }
}

// Steps that answer the request.
bool Board::answer_step(Step step) {
  switch (step) {
    case Step::kConfirmTorque:
      confirm_torque();
      return true;
    case Step::kReplyMove:
      reply_move();
      return true;
    case Step::kReplySyncWrite:
      reply(job_.bad ? gen::STATUS_SERVO_SILENT : gen::STATUS_OK, 0);
      return true;
    case Step::kReplyPacket:
      reply_packet();
      return true;
    case Step::kTakeTable:
      take_table();
      return true;
    case Step::kReplyTable:
      return reply_table();
    default:  // kReplyState
      reply(gen::STATUS_OK, put_state(job_.argument));
      return true;
  }
}

// Steps that wait for what the request needs, and what is done then.
bool Board::wait_step(Step step) {
  switch (step) {
    case Step::kAwaitCycle:
      return job_.cycles != poller_.cycles() && done();
    case Step::kAwaitStorage:
      return execute_later();
    case Step::kAwaitSaved:
      return reply_saved();
    default:
      decide(step);
      return true;
  }
}

// Steps that execute a request, now that it is known what the joints do.
void Board::decide(Step step) {
  if (step == Step::kSetPathStart) return set_path_start();
  if (step == Step::kChangeRate) return change_rate();
  enter_maintenance();
}

// Whether the time between two looks at joints that may move is not over.
bool Board::still_pausing() const {
  const uint32_t passed = ms_ - job_.noted_ms;
  return job_.program == kToRate ? passed < kRatePauseMs : job_.moving && passed < kPauseMs;
}

// Executes a request that had to wait for the storage.
bool Board::execute_later() {
  if (settings_.saving() == Saving::kBusy) return false;
  job_.active = false;
  execute();
  return true;
}

bool Board::done() {
  next_step();
  return true;
}

// Ends a step that put a packet without an answer into the send buffer, unless there was nothing to send.
bool Board::sent(bool packet) {
  next_step();
  if (!packet) return true;
  bus_.start_silent();
  owner_ = Owner::kJob;
  return false;
}

// Reads an item of many joints; continues with the next step when all are read.
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

}  // namespace hexwire
