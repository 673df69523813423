// Stops that wait for their turn or their answer, and requests that a stop has cancelled (PROTOCOL.md section 6.5).
// Both are bounded. Neither knows the effect of a stop on the servos.
#ifndef HEXWIRE_STOPS_H
#define HEXWIRE_STOPS_H

#include <stdint.h>
#include <string.h>

#include "frame.h"
#include "generated.h"
#include "joints.h"
#include "queue.h"

namespace hexwire {

constexpr uint8_t kStopModes = 2;  // 0 holds, 1 switches torque off
// Bytes of the frame that answers a stop.
constexpr uint8_t kStopAnswer = gen::FRAME_OVERHEAD + gen::STOP_REPLY_SIZE + 1;

// Hosts that asked for a stop and have no answer yet. One stop answers all requests for its mode that arrived before
// its end.
class StopList {
 public:
  struct Asker {
    int32_t src;
    uint8_t seq;
    uint8_t mode;
    bool done;
  };
  struct Outcome {
    uint8_t status;
    Mask mask;
  };

  StopList() : wanted_(), outcomes_(), count_(0), askers_() {}

  // False if there is no room for the answer; the stop is executed nevertheless.
  bool add(int32_t src, uint8_t seq, uint8_t mode) {
    if (count_ == kMost) return false;
    askers_[count_++] = Asker{src, seq, mode, false};
    return true;
  }
  bool holds(int32_t src, uint8_t seq, uint8_t mode) const {
    for (uint8_t i = 0; i < count_; ++i) {
      const Asker& asker = askers_[i];
      if (asker.src == src && asker.seq == seq && asker.mode == mode) return true;
    }
    return false;
  }

  void want(uint8_t mode) { wanted_[mode] = true; }
  bool wanted(uint8_t mode) const { return wanted_[mode]; }
  void done(uint8_t mode, uint8_t status, Mask mask) {
    wanted_[mode] = false;
    outcomes_[mode] = Outcome{status, mask};
    for (uint8_t i = 0; i < count_; ++i) {
      if (askers_[i].mode == mode) askers_[i].done = true;
    }
  }

  // Takes the first host that can be answered.
  bool take_done(Asker* asker, Outcome* outcome) {
    for (uint8_t i = 0; i < count_; ++i) {
      if (!askers_[i].done) continue;
      *asker = askers_[i];
      *outcome = outcomes_[asker->mode];
      --count_;
      memmove(&askers_[i], &askers_[i + 1], (count_ - i) * sizeof(Asker));
      return true;
    }
    return false;
  }
  bool empty() const { return count_ == 0 && !wanted_[0] && !wanted_[1]; }

 private:
  static constexpr uint8_t kMost = 16;

  bool wanted_[kStopModes];
  Outcome outcomes_[kStopModes];
  uint8_t count_;
  Asker askers_[kMost];
};

// Requests that a stop has voided: a repeat of one is not executed either. Requests that end a stop, switch torque on or
// begin maintenance are kept from their answer on, also from `busy`, because the next stop voids their repeats as well.
class VoidedStore {
 public:
  VoidedStore() : next_(0), checked_(0), entries_() {}

  void add(const Request& request, uint32_t now_ms) { put(request, now_ms, kVoid); }
  void add_done(const Request& request, uint32_t now_ms) {
    if (request.cmd == gen::CMD_RESUME || request.cmd == gen::CMD_TORQUE || request.cmd == gen::CMD_MAINTENANCE) {
      put(request, now_ms, kDone);
    }
  }
  // After a stop: requests executed before it are not executed again.
  void stop() {
    for (uint8_t i = 0; i < kMost; ++i) {
      if (entries_[i].state == kDone) entries_[i].state = kVoid;
    }
  }
  bool holds(const Frame& frame, uint32_t now_ms) const {
    const Request request = request_of(frame);
    uint16_t hashed = 0;
    bool known = false;
    for (uint8_t i = 0; i < kMost; ++i) {
      const Entry& entry = entries_[i];
      if (entry.state != kVoid || entry.seq != frame.seq || entry.cmd != frame.cmd || old(entry, now_ms)) continue;
      if (!known) hashed = hash(request);
      known = true;
      if (entry.hash == hashed) return true;
    }
    return false;
  }
  void forget(int32_t src) {
    for (uint8_t i = 0; i < kMost; ++i) {
      if (entries_[i].src == static_cast<uint8_t>(src)) entries_[i].state = kFree;
    }
  }
  // Checks one entry; must be called often, because the times wrap.
  void age(uint32_t now_ms) {
    Entry& entry = entries_[checked_];
    if (old(entry, now_ms)) entry.state = kFree;
    checked_ = static_cast<uint8_t>((checked_ + 1) % kMost);
  }

 private:
  static constexpr uint8_t kMost = 32;
  static constexpr uint8_t kFree = 0, kDone = 1, kVoid = 2;
  struct Entry {
    uint8_t state;
    uint8_t seq;
    uint8_t cmd;
    uint8_t src;  // its low byte; the hash has the rest
    uint16_t hash;
    uint16_t at_ms;
  };

  void put(const Request& request, uint32_t now_ms, uint8_t state);
  static bool old(const Entry& entry, uint32_t now_ms) {
    return static_cast<uint16_t>(now_ms - entry.at_ms) > gen::REPEAT_WINDOW_MS;
  }
  static uint16_t hash(const Request& request);

  uint8_t next_;
  uint8_t checked_;
  Entry entries_[kMost];
};

}  // namespace hexwire

#endif  // HEXWIRE_STOPS_H
