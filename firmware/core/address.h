// Whom a frame of dialect 2 is for: one module, several, or all (PROTOCOL.md section 6.9).
// Must not know what a command does.
#ifndef HEXWIRE_ADDRESS_H
#define HEXWIRE_ADDRESS_H

#include <stdint.h>

#include "generated.h"

namespace hexwire {

enum class Named : uint8_t { kNo, kAlone, kAmongSeveral };

// Whether a destination names the board.
inline Named names_board(int32_t dst) {
  constexpr uint8_t kModule = gen::MODULE_ARM_7BOT_ARDUINO_TRX;
  if (dst == kModule) return Named::kAlone;
  if (dst == gen::ADDRESS_BROADCAST) return Named::kAmongSeveral;
  const bool listed = dst >= gen::ADDRESS_MULTICAST && (dst & (1L << kModule));
  return listed ? Named::kAmongSeveral : Named::kNo;
}

// Commands that may go to several modules.
inline bool goes_to_several(uint8_t cmd) {
  struct Set {
    static constexpr uint32_t of(uint8_t code) { return 1UL << (code & 31); }
  };
  constexpr uint32_t kBelow20 = Set::of(gen::CMD_SYNC_WRITE) | Set::of(gen::CMD_IDENTIFY) | Set::of(gen::CMD_JOINT_STATE) |
                                Set::of(gen::CMD_REPORT) | Set::of(gen::CMD_JOINT_MOVE) | Set::of(gen::CMD_TORQUE) |
                                Set::of(gen::CMD_STOP) | Set::of(gen::CMD_RESUME) | Set::of(gen::CMD_WATCHDOG) |
                                Set::of(gen::CMD_STATS);
  constexpr uint32_t kFrom20 = Set::of(gen::CMD_TRAJECTORY_START) | Set::of(gen::CMD_TRAJECTORY_STATUS) |
                               Set::of(gen::CMD_TRAJECTORY_ABORT);
  static_assert(gen::CMD_STATS < 0x20 && gen::CMD_TRAJECTORY_START >= 0x20, "two sets of 32 codes");
  return cmd < 0x40 && ((cmd < 0x20 ? kBelow20 : kFrom20) & Set::of(cmd));
}

}  // namespace hexwire

#endif  // HEXWIRE_ADDRESS_H
