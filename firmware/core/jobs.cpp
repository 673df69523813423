#include "hot.h"  // first

// The commands that need more than one bus transaction, as lists of steps, and the code that runs them.
#include "board.h"
#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint8_t kPauseMs = 20;

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
  if (bus_.finished()) {
    const Owner owner = owner_;
    owner_ = Owner::kNobody;
    if (owner == Owner::kPoller) poller_.take_result(last_us_, ms_);
    if (owner == Owner::kJob && job_.entered) sweep_.take_result(last_us_, ms_);
  }
  if (!job_.active) start_next();
  // Start the next transaction before computing anything: the line should not lie idle meanwhile.
  if (job_.active && needs_bus()) run_job();
  // While a host that speaks the chapter's dialect is sending, the line is kept free for its request.
  const bool keep_free = decoder_.receiving() && (chapter_heard_ || !poller_.busy(ms_));
  const bool wanted = job_.active && needs_bus();
  if (bus_.idle() && !wanted && !keep_free && poller_.start(last_us_, ms_)) owner_ = Owner::kPoller;
  poller_.digest();
  run_job();
}

// A stop first; after it no request starts before every voided request and every stop is answered.
bool Board::start_next() {
  if (start_stop()) return true;
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
  return (step >= Step::kSendLegacy && step <= Step::kTakeRest) || step == Step::kReplyPacket;
}

// False if the step needs more time.
bool Board::run_step() {
  const Step step = job_.program[job_.pc];
  if (step <= Step::kReadTaken && !job_.entered && asked(step) == 0) {
    next_step();
    return true;
  }
  if (!bus_.idle() && needs_bus()) return false;
  bool silent = false;  // a packet without an answer is in the send buffer
  switch (step) {
    case Step::kReadPosition:
    case Step::kReadStale:
    case Step::kReadMoving:
      return sweep(Item::kPosition, asked(step));
    case Step::kReadTorque:
    case Step::kReadUnsure:
    case Step::kReadTaken:
      return sweep(Item::kTorque, asked(step));
    case Step::kReadMode:
    case Step::kReadUnknownMode:
      return sweep(Item::kMode, asked(step));
    case Step::kReadTarget:
      return sweep(Item::kTarget, asked(step));
    case Step::kReadCeiling:
      return sweep(Item::kCeiling, asked(step));
    case Step::kAimPresent:
      aim(job_.mask);
      break;
    case Step::kAimHold:
      aim_hold();
      break;
    case Step::kAimMove:
      aim_move();
      return true;
    case Step::kAimSyncWrite:
      aim_sync_write();
      return true;
    case Step::kJudgePacket:
      judge_packet();
      return true;
    case Step::kSendLegacy:
      silent = make_targets(gen::SERIES_SEVEN_BOT);
      break;
    case Step::kSendHls:
      silent = make_targets(gen::SERIES_HLS);
      break;
    case Step::kSendTorque:
      if (job_.program == kTorqueOn) {
        silent = joints_.make_torque(bus_, job_.targets.mask, true);
      } else {
        silent = take_torque(job_.mask);
      }
      break;
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
    case Step::kTakeOtherMode: {
      Mask wrong = 0;
      for (uint8_t i = 0; i < kJoints; ++i) {
        if (joints_[i].torque_on && joints_.other_mode(i)) wrong |= only(i);
      }
      silent = take_torque(wrong);
      job_.taken |= wrong;
      job_.targets.mask &= static_cast<Mask>(~wrong);
      break;
    }
    case Step::kTakeRest:
      silent = take_torque(job_.bad | job_.moving);
      job_.taken |= job_.bad | job_.moving;
      job_.targets.mask &= static_cast<Mask>(~job_.taken);
      break;
    case Step::kCheckTorque:
      check_torque();
      return true;
    case Step::kCheckTarget:
      check_target();
      return true;
    case Step::kNote:
      note_positions();
      break;
    case Step::kPause:
      if (job_.moving && ms_ - job_.noted_ms < kPauseMs) return false;
      break;
    case Step::kCheckStill:
      check_still();
      return true;
    case Step::kFinishHold:
      finish_hold();
      return true;
    case Step::kEndIfLimp:
      if (job_.targets.mask || job_.taken) break;
      job_.active = false;
      return true;
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
    case Step::kAwaitCycle:
      if (job_.cycles == poller_.cycles()) return false;
      break;
    case Step::kReplyState:
      reply(gen::STATUS_OK, put_state(job_.argument));
      return true;
    case Step::kAwaitStorage:
      if (settings_.saving() == Saving::kBusy) return false;
      job_.active = false;
      execute();
      return true;
    case Step::kAwaitSaved:
      return reply_saved();
    case Step::kMaintain:
      enter_maintenance();
      return true;
  }
  next_step();
  if (!silent) return true;
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
