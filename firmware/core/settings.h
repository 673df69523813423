// Settings that survive a reset: limits and offsets of every joint, each block with a version and a CRC.
// Owns the layout in storage and the slow, byte-by-byte writing. Must not know hosts.
#ifndef HEXWIRE_SETTINGS_H
#define HEXWIRE_SETTINGS_H

#include <stdint.h>

#include "generated.h"
#include "joints.h"
#include "platform.h"

namespace hexwire {

// Storage below this address has the boot counter of earlier firmware.
constexpr uint16_t kSettingsAt = 16;

enum class Block : uint8_t { kLimits, kOffsets };

enum class Saving : uint8_t { kIdle, kBusy, kStored, kFailed };

class Settings {
 public:
  explicit Settings(Platform& platform);

  // Reads both blocks; a damaged or missing block is replaced by the defaults.
  void load();
  bool is_default() const { return defaults_ != 0; }

  int16_t minimum(uint8_t joint) const;
  int16_t maximum(uint8_t joint) const;
  uint16_t speed(uint8_t joint) const;

  // The rows in their format on the line and in storage.
  const uint8_t* rows(Block block) const;
  static uint8_t rows_size(Block block);
  // Whether these rows are valid; they are used and stored only as a whole.
  static bool valid(Block block, const uint8_t* rows);

  // Whether rows that differ from the stored ones may be stored now. Storage bears a limited number of writes.
  bool may_save(Block block, const uint8_t* rows, uint32_t now_ms);
  // Starts storing; `poll` continues it. The new rows take effect once they are stored and read back.
  void save(Block block, const uint8_t* rows);
  void poll();
  Saving saving() const { return saving_; }
  void forget_result() { saving_ = Saving::kIdle; }

 private:
  static constexpr uint8_t kLimitsSize = kJoints * gen::LIMITS_REPLY_ROW_SIZE;
  static constexpr uint8_t kOffsetsSize = kJoints * gen::OFFSETS_REPLY_ROW_SIZE;
  static constexpr uint8_t kOverhead = 4;  // version, joints, CRC

  static uint16_t address(Block block);
  bool read_block(Block block, uint8_t* rows) const;
  void set_defaults(Block block);

  Platform& platform_;
  uint8_t saves_left_;
  uint32_t gained_ms_;
  uint8_t defaults_;  // bit per block
  Saving saving_;
  Block block_;
  uint8_t position_;
  uint8_t limits_[kLimitsSize];
  uint8_t offsets_[kOffsetsSize];
  uint8_t image_[kLimitsSize + kOverhead];
};

}  // namespace hexwire

#endif  // HEXWIRE_SETTINGS_H
