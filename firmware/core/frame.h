// Session frames: delimited in a stream by their size, and serialized (PROTOCOL.md sections 2, 3 and 6).
// Owns the receive buffer of one frame. Must not know commands.
#ifndef HEXWIRE_FRAME_H
#define HEXWIRE_FRAME_H

#include <stdint.h>

#include "generated.h"
#include "stats.h"

namespace hexwire {

constexpr uint8_t kBodyAt = gen::HEADER_SIZE + 8;
constexpr uint8_t kMaxBody = gen::MAX_SERIAL_FRAME - gen::FRAME_OVERHEAD;

struct Frame {
  int32_t src;
  int32_t dst;
  uint8_t proto;
  uint8_t seq;
  uint8_t cmd;
  uint8_t ext;
  uint8_t size;  // of the body
  const uint8_t* body;
};

class FrameDecoder {
 public:
  explicit FrameDecoder(Stats& stats);

  // Where the next bytes go, and how many fit; 0 while a frame that `next` returned is still held.
  uint8_t* space() { return buffer_ + held_; }
  uint8_t room() const { return static_cast<uint8_t>(sizeof(buffer_) - held_); }
  void added(uint8_t count, uint32_t now);

  // The next valid frame. It stays valid until the next call.
  bool next(Frame& frame);

  // Abandons an unfinished frame after the inter-byte timeout; true if `next` should be called again.
  bool expire(uint32_t now);

  // Drops an unfinished frame.
  void forget() { held_ = 0; }

  // Minimum number of bytes missing before `next` can find a frame.
  uint8_t missing() const;

  // Whether the start of a possible frame has arrived.
  bool receiving() const { return held_ > 0; }

 private:
  static constexpr uint8_t kMore = 0;
  static constexpr uint8_t kNoFrame = 1;
  static constexpr uint8_t kBadTail = 2;
  static constexpr uint8_t kBadCheck = 3;

  uint8_t examine(const uint8_t* p, uint8_t count) const;
  void drop(uint8_t count);
  void skip(uint8_t count);

  Stats& stats_;
  uint32_t last_;
  uint8_t held_;
  uint8_t done_;  // bytes of `buffer_` that belong to the frame returned last
  bool skipping_;
  uint8_t buffer_[gen::MAX_SERIAL_FRAME];
};

struct FrameHead {
  uint32_t time_sec;
  uint32_t time_nsec;
  uint32_t sn;
  int32_t src;
  int32_t dst;
  uint8_t proto;
  uint8_t seq;
  uint8_t cmd;
  uint8_t ext;
};

// Puts a frame around the `body_size` bytes at `frame + kBodyAt`; returns the frame's size.
uint8_t finish_frame(uint8_t* frame, const FrameHead& head, uint8_t body_size);

}  // namespace hexwire

#endif  // HEXWIRE_FRAME_H
