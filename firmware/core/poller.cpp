#include "hot.h"  // first

#include "poller.h"

namespace hexwire {

namespace {

constexpr uint16_t kAwakeMs = 2000;
constexpr uint16_t kIdleCycleMs = 100;
constexpr uint16_t kSilentRetryMs = 500;  // an absent servo is not asked in every cycle
// The slow items reduce the rate of the positions, so they take turns: once in this many cycles the HLS servos give
// speed, load, voltage and temperature with the position, and half-way between, one joint is asked for one other
// item. docs/firmware.md has the figures.
constexpr uint8_t kCyclesPerTurn = 16;
constexpr uint8_t kExtraAt = 8;
constexpr uint8_t kExtrasPerRest = 3;      // when there is time to spare before a report
constexpr int32_t kExtraUs = 2500;         // the longest of them, with a margin
constexpr int32_t kTransactionUs = 2000;   // a read of one position, with a margin

// The items that take turns. Torque is among them because a servo may switch it off on its own.
const Item kExtras[] = {Item::kSupply, Item::kTorque, Item::kCurrent};
constexpr uint8_t kExtraCount = sizeof(kExtras) / sizeof(kExtras[0]);

}  // namespace

Poller::Poller(ServoBus& bus, Joints& joints, Sweep::Raw* raw)
    : PollerFields(), bus_(bus), joints_(joints), sweep_(bus, joints, raw) {}

void Poller::wake(uint32_t now_ms) {
  awake_ = true;
  awake_until_ms_ = now_ms + kAwakeMs;
}

void Poller::set_report(uint16_t period_ms, uint32_t now_us) {
  period_ms_ = period_ms;
  report_ready_ = false;
  report_at_us_ = now_us + static_cast<uint32_t>(period_ms) * 1000;
}

bool Poller::take_report(uint32_t now_us) {
  if (!report_ready_ || static_cast<int32_t>(report_at_us_ - now_us) > 0) return false;
  report_ready_ = false;
  report_at_us_ += static_cast<uint32_t>(period_ms_) * 1000;
  // Reports that could not be sent in time are skipped.
  if (static_cast<int32_t>(report_at_us_ - now_us) < 0) report_at_us_ = now_us;
  return true;
}

Mask Poller::worth_asking(uint32_t now_ms) const {
  Mask mask = 0;
  for (uint8_t i = 0; i < kJoints; ++i) {
    const Joint& joint = joints_[i];
    if (joint.present || now_ms - joint.asked_ms >= kSilentRetryMs) mask |= only(i);
  }
  return mask | wanted_;
}

Item Poller::item_of(uint8_t cycle, uint32_t now_ms) const {
  return !busy(now_ms) || cycle % kCyclesPerTurn == 0 ? Item::kMotion : Item::kPosition;
}

bool Poller::start_cycle(uint32_t now_us, uint32_t now_ms) {
  phase_ = Phase::kCycle;
  cycle_begun_us_ = now_us;
  if (cycles_ == 0) joints_.try_sync_again();
  // A host that only reads by the chapter's dialect should not find the line occupied by a long sync read.
  sweep_.begin(worth_asking(now_ms), item_of(cycles_, now_ms), busy(now_ms));
  if (sweep_.start_next(now_ms)) return true;
  end_cycle(now_us, now_ms);
  return false;
}

bool Poller::prepare(uint32_t now_us, uint32_t now_ms, bool own) {
  if (phase_ == Phase::kRest) return false;
  if (sweep_.prepare(now_ms, own)) return true;
  if (!own || extra_due_ || !sweep_.at_last() || joints_.is_lacking()) return false;
  return prepare_phase(now_us, now_ms) && sweep_.prepare(now_ms, false);
}

// Begins what follows the phase whose last transaction runs.
bool Poller::prepare_phase(uint32_t now_us, uint32_t now_ms) {
  const uint8_t cycle = static_cast<uint8_t>(phase_ == Phase::kCycle ? cycles_ + 1 : cycles_);
  if (phase_ == Phase::kCycle && cycle % kCyclesPerTurn == kExtraAt) {
    uint8_t joint;
    Item item;
    if (!find_extra(&joint, &item)) return false;
    sweep_.begin_after(only(joint), item, false);
    next_phase_ = Phase::kExtra;
    return true;
  }
  if (!cycle_follows(now_us, now_ms)) return false;
  if (cycle == 0) joints_.try_sync_again();
  sweep_.begin_after(worth_asking(now_ms), item_of(cycle, now_ms), busy(now_ms));
  next_phase_ = Phase::kCycle;
  return true;
}

// Whether `start` will begin a cycle as soon as the transaction that runs is over.
bool Poller::cycle_follows(uint32_t now_us, uint32_t now_ms) const {
  if (period_ms_ == 0) return awake(now_ms);
  const int32_t spare = static_cast<int32_t>(report_at_us_ - cycle_us_ - now_us);
  return spare <= 0 || (awake(now_ms) && spare >= static_cast<int32_t>(cycle_us_) + kTransactionUs);
}

bool Poller::start_extra(uint32_t now_ms) {
  uint8_t joint;
  Item item;
  joint = joints_.lacking(&item);
  if (joint == kNoJoint && !find_extra(&joint, &item)) return false;
  sweep_.begin(only(joint), item, false);
  phase_ = Phase::kExtra;
  return sweep_.start_next(now_ms);
}

// The next of the items that take turns.
bool Poller::find_extra(uint8_t* joint, Item* item) {
  for (uint8_t tried = 0; tried < kJoints * kExtraCount; ++tried) {
    *joint = static_cast<uint8_t>(turn_ % kJoints);
    *item = kExtras[turn_ / kJoints];
    if (++turn_ == kJoints * kExtraCount) turn_ = 0;
    if (!joints_[*joint].present || !joints_.has(*joint, *item)) continue;
    if (extras_left_) --extras_left_;
    return true;
  }
  return false;
}

bool Poller::start(uint32_t now_us, uint32_t now_ms) {
  if (phase_ != Phase::kRest && go_on(now_us, now_ms)) return true;
  if (awake_ && !awake(now_ms)) awake_ = false;
  if (extra_due_) {
    extra_due_ = false;
    if (start_extra(now_ms)) return true;
  }
  const bool due = cycle_due(now_ms);
  if (period_ms_) {
    // The cycle should end when the report is due; the time left before it goes to the slow items.
    const int32_t spare = static_cast<int32_t>(report_at_us_ - cycle_us_ - now_us);
    if (spare > 0 && (!due || spare < static_cast<int32_t>(cycle_us_))) return start_spare(spare, now_ms);
  } else if (!due) {
    return false;
  }
  return start_cycle(now_us, now_ms);
}

bool Poller::cycle_due(uint32_t now_ms) const { return awake_ || now_ms - cycle_at_ms_ >= kIdleCycleMs; }

// Asks for a slow item before a report, if there is time.
bool Poller::start_spare(int32_t spare_us, uint32_t now_ms) {
  if (spare_us < static_cast<int32_t>(cycle_us_) && spare_us <= kExtraUs) return false;
  return extras_left_ && start_extra(now_ms);
}

// Starts the next transaction of what is under way; false if it is complete.
bool Poller::go_on(uint32_t now_us, uint32_t now_ms) {
  if (sweep_.start_next(now_ms)) return true;
  if (phase_ == Phase::kCycle) end_cycle(now_us, now_ms);
  phase_ = Phase::kRest;
  return false;
}

void Poller::take_result(uint32_t now_us, uint32_t now_ms) {
  const bool ends = sweep_.ends_last();
  sweep_.take_result(now_us, now_ms);
  if (phase_ == Phase::kCycle && bus_.result() == BusResult::kOk) sampled_us_ = now_us;
  if (!ends) return;
  if (phase_ == Phase::kCycle) end_cycle(now_us, now_ms);
  phase_ = next_phase_;
  if (phase_ == Phase::kExtra) {
    extra_due_ = false;
  } else {
    cycle_begun_us_ = now_us;
  }
}

void Poller::end_cycle(uint32_t now_us, uint32_t now_ms) {
  phase_ = Phase::kRest;
  cycle_us_ = now_us - cycle_begun_us_;
  cycle_at_ms_ = now_ms;
  ++cycles_;
  if (cycles_ % kCyclesPerTurn == kExtraAt || joints_.is_lacking()) extra_due_ = true;
  extras_left_ = kExtrasPerRest;
  const int32_t early = static_cast<int32_t>(report_at_us_ - now_us);
  if (period_ms_ != 0 && early < static_cast<int32_t>(cycle_us_ / 2)) report_ready_ = true;
}

}  // namespace hexwire
