// The rate of the host line: raised by HOST_BAUD, and back at the board's own when nothing valid is heard (PROTOCOL.md,
// section 6.8). Owns when the rate changes. Must not know frames, nor whether a change is safe.
#ifndef HEXWIRE_HOST_RATE_H
#define HEXWIRE_HOST_RATE_H

#include <stdint.h>

#include "platform.h"

namespace hexwire {

class HostRate {
 public:
  explicit HostRate(Platform& platform);

  // Whether the line has a rate that can be changed.
  bool can_change() const { return platform_.host_own_rate() != 0; }
  bool known(uint32_t rate) const;
  uint32_t own() const { return platform_.host_own_rate(); }
  uint32_t now() const { return rate_of(code_); }

  // Changes to a known rate once everything is sent. Until then nothing may be sent, nor executed but a stop.
  void change(uint32_t rate);
  bool changing() const { return phase_ == Phase::kSending || phase_ == Phase::kLastBytes; }

  // A valid frame arrived.
  void heard(uint32_t now_ms);
  // True if the rate has just changed: what was held of a frame is void.
  bool poll(uint32_t now_ms);

 private:
  enum class Phase : uint8_t { kOwn, kSending, kLastBytes, kTrial, kRaised };

  uint32_t rate_of(uint8_t code) const;
  bool set(uint8_t code, Phase phase, uint32_t now_ms);

  Platform& platform_;
  Phase phase_;
  uint8_t code_;       // of the present rate: 0 is the board's own, others are in the table of the source
  uint8_t next_;
  uint16_t since_ms_;  // begin of the phase, or the last valid frame
};

}  // namespace hexwire

#endif  // HEXWIRE_HOST_RATE_H
