#include "settings.h"

#include <string.h>

#include "bytes.h"

namespace hexwire {

Settings::Settings(Platform& platform)
    : platform_(platform),
      saves_left_(gen::SETTINGS_STORES),
      gained_ms_(0),
      defaults_(0),
      saving_(Saving::kIdle),
      block_(Block::kLimits),
      position_(0),
      limits_(),
      offsets_(),
      image_() {}

uint16_t Settings::address(Block block) {
  return block == Block::kLimits ? kSettingsAt : kSettingsAt + kLimitsSize + kOverhead;
}

uint8_t Settings::rows_size(Block block) { return block == Block::kLimits ? kLimitsSize : kOffsetsSize; }

const uint8_t* Settings::rows(Block block) const { return block == Block::kLimits ? limits_ : offsets_; }

int16_t Settings::minimum(uint8_t joint) const {
  return static_cast<int16_t>(get16(limits_ + joint * gen::LIMITS_REPLY_ROW_SIZE + gen::LIMITS_REPLY_ROW_MINIMUM));
}

int16_t Settings::maximum(uint8_t joint) const {
  return static_cast<int16_t>(get16(limits_ + joint * gen::LIMITS_REPLY_ROW_SIZE + gen::LIMITS_REPLY_ROW_MAXIMUM));
}

uint16_t Settings::speed(uint8_t joint) const {
  return get16(limits_ + joint * gen::LIMITS_REPLY_ROW_SIZE + gen::LIMITS_REPLY_ROW_SPEED);
}

bool Settings::valid(Block block, const uint8_t* rows) {
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (block == Block::kLimits) {
      const int16_t low = static_cast<int16_t>(get16(rows + gen::LIMITS_REPLY_ROW_MINIMUM));
      const int16_t high = static_cast<int16_t>(get16(rows + gen::LIMITS_REPLY_ROW_MAXIMUM));
      if (low >= high || get16(rows + gen::LIMITS_REPLY_ROW_SPEED) == 0) return false;
      rows += gen::LIMITS_REPLY_ROW_SIZE;
    } else {
      const int8_t sign = static_cast<int8_t>(rows[gen::OFFSETS_REPLY_ROW_SIGN]);
      if (sign != 1 && sign != -1) return false;
      rows += gen::OFFSETS_REPLY_ROW_SIZE;
    }
  }
  return true;
}

void Settings::set_defaults(Block block) {
  uint8_t* rows = block == Block::kLimits ? limits_ : offsets_;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (block == Block::kLimits) {
      put16(rows + gen::LIMITS_REPLY_ROW_MINIMUM, gen::DEFAULT_MINIMUM);
      put16(rows + gen::LIMITS_REPLY_ROW_MAXIMUM, gen::DEFAULT_MAXIMUM);
      put16(rows + gen::LIMITS_REPLY_ROW_SPEED, gen::DEFAULT_SPEED);
      rows += gen::LIMITS_REPLY_ROW_SIZE;
    } else {
      put16(rows + gen::OFFSETS_REPLY_ROW_NEUTRAL, gen::DEFAULT_NEUTRAL);
      rows[gen::OFFSETS_REPLY_ROW_SIGN] = gen::DEFAULT_SIGN;
      rows += gen::OFFSETS_REPLY_ROW_SIZE;
    }
  }
  defaults_ = static_cast<uint8_t>(defaults_ | (1 << static_cast<uint8_t>(block)));
}

bool Settings::read_block(Block block, uint8_t* rows) const {
  uint16_t at = address(block);
  const uint8_t size = rows_size(block);
  const uint8_t version = platform_.storage_read(at++);
  const uint8_t joints = platform_.storage_read(at++);
  if (version != gen::SETTINGS_VERSION || joints != kJoints) return false;
  uint16_t crc = crc16_update(crc16_update(0xFFFF, version), joints);
  for (uint8_t i = 0; i < size; ++i) {
    rows[i] = platform_.storage_read(at++);
    crc = crc16_update(crc, rows[i]);
  }
  const uint8_t check[2] = {platform_.storage_read(at), platform_.storage_read(static_cast<uint16_t>(at + 1))};
  return get16(check) == crc && valid(block, rows);
}

void Settings::load() {
  defaults_ = 0;
  if (!read_block(Block::kLimits, limits_)) set_defaults(Block::kLimits);
  if (!read_block(Block::kOffsets, offsets_)) set_defaults(Block::kOffsets);
}

bool Settings::may_save(Block block, const uint8_t* wanted, uint32_t now_ms) {
  while (saves_left_ < gen::SETTINGS_STORES && now_ms - gained_ms_ >= gen::SETTINGS_STORE_EVERY_MS) {
    ++saves_left_;
    gained_ms_ += gen::SETTINGS_STORE_EVERY_MS;
  }
  const bool stored = !(defaults_ & (1 << static_cast<uint8_t>(block)));
  if (stored && memcmp(rows(block), wanted, rows_size(block)) == 0) return true;
  if (saves_left_ == 0) return false;
  // While all are there, no time passes.
  if (saves_left_ == gen::SETTINGS_STORES) gained_ms_ = now_ms;
  --saves_left_;
  return true;
}

void Settings::save(Block block, const uint8_t* rows) {
  const uint8_t size = rows_size(block);
  block_ = block;
  position_ = 0;
  saving_ = Saving::kBusy;
  image_[0] = gen::SETTINGS_VERSION;
  image_[1] = kJoints;
  memcpy(image_ + 2, rows, size);
  put16(image_ + 2 + size, crc16(image_, static_cast<uint16_t>(2 + size)));
}

void Settings::poll() {
  if (saving_ != Saving::kBusy || !platform_.storage_ready()) return;
  const uint8_t size = static_cast<uint8_t>(rows_size(block_) + kOverhead);
  const uint16_t base = address(block_);
  // Bytes that are already right are skipped: writing takes time and wears the storage.
  while (position_ < size && platform_.storage_read(static_cast<uint16_t>(base + position_)) == image_[position_]) {
    ++position_;
  }
  if (position_ < size) {
    platform_.storage_write(static_cast<uint16_t>(base + position_), image_[position_]);
    ++position_;
    return;
  }
  for (uint8_t i = 0; i < size; ++i) {
    if (platform_.storage_read(static_cast<uint16_t>(base + i)) != image_[i]) {
      saving_ = Saving::kFailed;
      load();
      return;
    }
  }
  memcpy(block_ == Block::kLimits ? limits_ : offsets_, image_ + 2, rows_size(block_));
  defaults_ = static_cast<uint8_t>(defaults_ & ~(1 << static_cast<uint8_t>(block_)));
  saving_ = Saving::kStored;
}

}  // namespace hexwire
