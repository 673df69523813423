#include "boot_counter.h"

#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint16_t kPlacesAt = 1024;
constexpr uint8_t kPlaces = 64;
constexpr uint8_t kSize = 4;
constexpr uint16_t kFormerAt = 0;           // where earlier firmware counted
constexpr uint32_t kHighest = 0xFFFF0000;   // above it is what was never written, or is damaged

uint32_t read(Platform& platform, uint16_t at) {
  uint8_t bytes[kSize];
  for (uint8_t i = 0; i < kSize; ++i) bytes[i] = platform.storage_read(static_cast<uint16_t>(at + i));
  const uint32_t id = get32(bytes);
  return id < kHighest ? id : 0;
}

uint16_t place_of(uint32_t id) { return static_cast<uint16_t>(kPlacesAt + id % kPlaces * kSize); }

}  // namespace

uint32_t next_boot_id(Platform& platform) {
  uint32_t newest = read(platform, kFormerAt);
  for (uint8_t i = 0; i < kPlaces; ++i) {
    const uint16_t at = static_cast<uint16_t>(kPlacesAt + i * kSize);
    const uint32_t id = read(platform, at);
    // An id that does not belong there is damage.
    if (id > newest && place_of(id) == at) newest = id;
  }
  const uint32_t next = newest + 1;
  uint8_t bytes[kSize];
  put32(bytes, next);
  // If the power fails meanwhile, nobody has heard of this id yet.
  for (uint8_t i = 0; i < kSize; ++i) {
    const uint16_t at = static_cast<uint16_t>(place_of(next) + i);
    if (platform.storage_read(at) != bytes[i]) platform.storage_write(at, bytes[i]);
  }
  return next;
}

}  // namespace hexwire
