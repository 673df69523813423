// The board's own polling of the servos, and the times of reports.
// Positions are read every cycle; the slower items take turns in between. Owns no bytes: it starts transactions
// through a sweep, and only while the bus is idle.
#ifndef HEXWIRE_POLLER_H
#define HEXWIRE_POLLER_H

#include <stdint.h>

#include "joints.h"
#include "servo_bus.h"

namespace hexwire {

// The fields of a poller. All begin as zero: together in a struct, they are cleared by one loop instead of one by one.
struct PollerFields {
  enum class Phase : uint8_t { kRest, kCycle, kExtra };

  Phase phase_;
  Phase next_phase_;  // of what is prepared after the last transaction of a phase
  bool awake_;
  bool report_ready_;
  uint8_t cycles_;
  bool extra_due_;
  Mask wanted_;
  uint8_t turn_;  // item * kJoints + joint of the next extra
  uint8_t extras_left_;
  uint16_t period_ms_;
  uint32_t awake_until_ms_;
  uint32_t report_at_us_;
  uint32_t cycle_begun_us_;
  uint32_t cycle_us_;
  uint32_t cycle_at_ms_;
  uint32_t sampled_us_;
};

class Poller : private PollerFields {
 public:
  Poller(ServoBus& bus, Joints& joints, Sweep::Raw* raw);

  // A host wants fresh joint states: poll without a pause for the next seconds.
  void wake(uint32_t now_ms);
  bool awake(uint32_t now_ms) const { return awake_ && static_cast<int32_t>(awake_until_ms_ - now_ms) > 0; }

  // Joints that are asked in every cycle even if they are silent.
  void want(Mask joints) { wanted_ = joints; }

  // Reports are on, or a host asks: polling positions has priority over an idle line.
  bool busy(uint32_t now_ms) const { return period_ms_ != 0 || awake(now_ms); }

  // 0 stops the reports.
  void set_report(uint16_t period_ms, uint32_t now_us);
  // True once when a report is due and its samples are available.
  bool take_report(uint32_t now_us);

  // Starts a transaction if one is due; true if it did.
  bool start(uint32_t now_us, uint32_t now_ms);
  // Prepares the transaction that follows the one that runs, which is its own or not; false if that must be seen then.
  bool prepare(uint32_t now_us, uint32_t now_ms, bool own);
  void take_result(uint32_t now_us, uint32_t now_ms);
  // What it prepared has been started.
  void went_on() { sweep_.went_on(); }
  // Processes the last result while the next answer is pending.
  void digest() { sweep_.digest(); }

  // Counts finished cycles; wraps.
  uint8_t cycles() const { return cycles_; }
  uint32_t cycle_at_ms() const { return cycle_at_ms_; }
  uint32_t sampled_us() const { return sampled_us_; }

 private:
  Mask worth_asking(uint32_t now_ms) const;
  Item item_of(uint8_t cycle, uint32_t now_ms) const;
  bool start_cycle(uint32_t now_us, uint32_t now_ms);
  bool prepare_phase(uint32_t now_us, uint32_t now_ms);
  bool cycle_follows(uint32_t now_us, uint32_t now_ms) const;
  bool go_on(uint32_t now_us, uint32_t now_ms);
  bool start_extra(uint32_t now_ms);
  bool find_extra(uint8_t* joint, Item* item);
  bool cycle_due(uint32_t now_ms) const;
  bool start_spare(int32_t spare_us, uint32_t now_ms);
  void end_cycle(uint32_t now_us, uint32_t now_ms);

  ServoBus& bus_;
  Joints& joints_;
  Sweep sweep_;
};

}  // namespace hexwire

#endif  // HEXWIRE_POLLER_H
