// Integers in byte arrays and the three checks of the wire format (PROTOCOL.md sections 3, 4 and 6).
// Must not know frames; everything is inline and without storage.
#ifndef HEXWIRE_BYTES_H
#define HEXWIRE_BYTES_H

#include <stdint.h>

namespace hexwire {

inline uint16_t get16(const uint8_t* p) {
  return static_cast<uint16_t>(p[0] | (static_cast<uint16_t>(p[1]) << 8));
}

inline int16_t signed16(const uint8_t* p) { return static_cast<int16_t>(get16(p)); }

inline uint16_t get16_big(const uint8_t* p) {
  return static_cast<uint16_t>(p[1] | (static_cast<uint16_t>(p[0]) << 8));
}

inline uint32_t get32(const uint8_t* p) {
  return get16(p) | (static_cast<uint32_t>(get16(p + 2)) << 16);
}

inline void put16(uint8_t* p, uint16_t value) {
  p[0] = static_cast<uint8_t>(value);
  p[1] = static_cast<uint8_t>(value >> 8);
}

inline void put16_big(uint8_t* p, uint16_t value) {
  p[0] = static_cast<uint8_t>(value >> 8);
  p[1] = static_cast<uint8_t>(value);
}

inline void put32(uint8_t* p, uint32_t value) {
  put16(p, static_cast<uint16_t>(value));
  put16(p + 2, static_cast<uint16_t>(value >> 16));
}

// Sign-magnitude as the Feetech series use it: `sign` is the mask of the sign bit, 0 for unsigned.
inline int16_t decode_signed(uint16_t raw, uint16_t sign) {
  if (sign == 0) return static_cast<int16_t>(raw);
  const int16_t magnitude = static_cast<int16_t>(raw & (sign - 1));
  return raw & sign ? static_cast<int16_t>(-magnitude) : magnitude;
}

inline uint16_t encode_signed(int16_t value, uint16_t sign) {
  return value < 0 ? static_cast<uint16_t>(static_cast<uint16_t>(-static_cast<int32_t>(value)) | sign)
                   : static_cast<uint16_t>(value);
}

// CRC-16/IBM-3740, one byte. Written in 8-bit steps: on an AVR a 16-bit shift by 5 or 12 is a loop.
inline uint16_t crc16_update(uint16_t crc, uint8_t byte) {
  uint8_t x = static_cast<uint8_t>((crc >> 8) ^ byte);
  x = static_cast<uint8_t>(x ^ (x >> 4));
  const uint8_t high = static_cast<uint8_t>(crc ^ static_cast<uint8_t>(x << 4) ^ (x >> 3));
  const uint8_t low = static_cast<uint8_t>(x ^ static_cast<uint8_t>(x << 5));
  return static_cast<uint16_t>((static_cast<uint16_t>(high) << 8) | low);
}

// The same over many bytes, continuing from `crc`.
uint16_t crc16(const uint8_t* p, uint16_t n, uint16_t crc = 0xFFFF);

// Checksum of a servo packet: `p` points at its id, `n` counts id, length byte, instruction and parameters.
inline uint8_t servo_checksum(const uint8_t* p, uint8_t n) {
  uint8_t sum = 0;
  while (n--) sum = static_cast<uint8_t>(sum + *p++);
  return static_cast<uint8_t>(~sum);
}

}  // namespace hexwire

#endif  // HEXWIRE_BYTES_H
