#include "hot.h"  // first

#include "frame.h"

#include <string.h>

#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint8_t kSync[4] = {gen::SYNC & 0xFF, (gen::SYNC >> 8) & 0xFF, (gen::SYNC >> 16) & 0xFF, gen::SYNC >> 24};
constexpr uint8_t kAppAt = gen::HEADER_SIZE;  // flag, proto, seq, pad, len u16, cmd, cmd_ext

uint8_t pad_of(uint8_t body_size) { return static_cast<uint8_t>(-body_size & 3); }

// Whether the bytes received so far at `p` could be the start of a frame.
bool may_start(const uint8_t* p, uint8_t count) {
  for (uint8_t i = 0; i < sizeof(kSync) && i < count; ++i) {
    if (p[i] != kSync[i]) return false;
  }
  return true;
}

// Whether flag and dialect are known, and the lengths belong to a frame of that size.
bool sizes_agree(const uint8_t* app, uint32_t size) {
  if (app[0] != gen::FRAME_FLAG || (app[1] != gen::PROTO_CHAPTER && app[1] != gen::PROTO_HEXWIRE)) return false;
  const uint8_t pad = app[3];
  const uint16_t body = get16(app + 4);
  if (body > kMaxBody || pad != pad_of(static_cast<uint8_t>(body))) return false;
  return size == static_cast<uint32_t>(gen::FRAME_OVERHEAD) + body + pad;
}

uint16_t check_of(const uint8_t* p, uint16_t covered) {
  const uint16_t check = crc16(p, covered);
  return check == gen::UNCHECKED ? 0 : check;
}

}  // namespace

#if defined(__GNUC__)
__attribute__((noinline))
#endif
uint16_t crc16(const uint8_t* p, uint16_t n, uint16_t crc) {
  while (n--) crc = crc16_update(crc, *p++);
  return crc;
}

FrameDecoder::FrameDecoder(Stats& stats) : stats_(stats), last_(0), held_(0), done_(0), skipping_(false) {}

void FrameDecoder::added(uint8_t count, uint32_t now) {
  held_ = static_cast<uint8_t>(held_ + count);
  if (count) last_ = now;
}

void FrameDecoder::drop(uint8_t count) {
  held_ = static_cast<uint8_t>(held_ - count);
  memmove(buffer_, buffer_ + count, held_);
}

void FrameDecoder::skip(uint8_t count) {
  if (count == 0) return;
  stats_.bytes_dropped += count;
  if (!skipping_) ++stats_.resyncs;
  skipping_ = true;
}

// One of the constants up to kBadCheck, or the size of a whole valid frame.
uint8_t FrameDecoder::examine(const uint8_t* p, uint8_t count) const {
  if (count < gen::HEADER_SIZE) return kMore;
  const uint32_t size = get32(p + gen::HEADER_AT_SIZE);
  if (size < gen::FRAME_OVERHEAD || size > gen::MAX_SERIAL_FRAME) return kNoFrame;
  if (count < kBodyAt) return kMore;
  const uint8_t* app = p + kAppAt;
  if (!sizes_agree(app, size)) return kNoFrame;
  const uint8_t whole = static_cast<uint8_t>(size);
  if (count < whole) return kMore;
  if (p[whole - 2] != gen::TAIL_0 || p[whole - 1] != gen::TAIL_1) return kBadTail;
  if (app[1] == gen::PROTO_HEXWIRE) {
    const uint16_t covered = static_cast<uint16_t>(kBodyAt + get16(app + 4));
    if (get16(p + covered) != check_of(p, covered)) return kBadCheck;
  }
  return whole;
}

bool FrameDecoder::next(Frame& frame) {
  if (done_) {
    drop(done_);
    done_ = 0;
  }
  uint8_t start = 0;
  while (start < held_) {
    const uint8_t* p = buffer_ + start;
    const uint8_t count = static_cast<uint8_t>(held_ - start);
    if (!may_start(p, count)) {
      skip(1);
      ++start;
      continue;
    }
    const uint8_t found = examine(p, count);
    if (found == kMore) break;
    if (found == kNoFrame) {
      skip(1);
      ++start;
      continue;
    }
    skipping_ = false;
    if (found == kBadTail || found == kBadCheck) {
      ++stats_.bad_frames;
      if (found == kBadCheck) ++stats_.bad_checks;
      ++stats_.bytes_dropped;
      ++start;
      continue;
    }
    ++stats_.frames_received;
    frame.src = static_cast<int32_t>(get32(p + gen::HEADER_AT_SRC));
    frame.dst = static_cast<int32_t>(get32(p + gen::HEADER_AT_DST));
    frame.proto = p[kAppAt + 1];
    frame.seq = p[kAppAt + 2];
    frame.size = static_cast<uint8_t>(get16(p + kAppAt + 4));
    frame.cmd = p[kAppAt + 6];
    frame.ext = p[kAppAt + 7];
    frame.body = p + kBodyAt;
    done_ = static_cast<uint8_t>(start + found);
    return true;
  }
  if (start) drop(start);
  return false;
}

uint8_t FrameDecoder::missing() const {
  uint8_t size = gen::FRAME_OVERHEAD;
  // After `next` the buffer holds a plausible header or the start of one.
  if (held_ >= gen::HEADER_SIZE) size = buffer_[gen::HEADER_AT_SIZE];
  return size > held_ ? static_cast<uint8_t>(size - held_) : 1;
}

bool FrameDecoder::expire(uint32_t now) {
  if (held_ == 0 || now - last_ < gen::INTERBYTE_TIMEOUT_MS * 1000UL) return false;
  if (held_ < sizeof(kSync)) {
    skip(held_);
    held_ = 0;
    return false;
  }
  ++stats_.bad_frames;
  ++stats_.bytes_dropped;
  drop(1);
  return true;
}

uint8_t finish_frame(uint8_t* frame, const FrameHead& head, uint8_t body_size) {
  const uint8_t pad = pad_of(body_size);
  const uint8_t size = static_cast<uint8_t>(gen::FRAME_OVERHEAD + body_size + pad);
  put32(frame + gen::HEADER_AT_SYNC, gen::SYNC);
  put32(frame + gen::HEADER_AT_TIME_SEC, head.time_sec);
  put32(frame + gen::HEADER_AT_TIME_NSEC, head.time_nsec);
  put32(frame + gen::HEADER_AT_SN, head.sn);
  put32(frame + gen::HEADER_AT_SRC, static_cast<uint32_t>(head.src));
  put32(frame + gen::HEADER_AT_DST, static_cast<uint32_t>(head.dst));
  put32(frame + gen::HEADER_AT_TYPE, static_cast<uint32_t>(gen::MODULE_ARM_7BOT_ARDUINO_TRX));
  put32(frame + gen::HEADER_AT_SIZE, size);
  uint8_t* app = frame + kAppAt;
  app[0] = gen::FRAME_FLAG;
  app[1] = head.proto;
  app[2] = head.seq;
  app[3] = pad;
  put16(app + 4, body_size);
  app[6] = head.cmd;
  app[7] = head.ext;
  const uint16_t covered = static_cast<uint16_t>(kBodyAt + body_size);
  const uint16_t check = head.proto == gen::PROTO_HEXWIRE ? check_of(frame, covered) : gen::UNCHECKED;
  uint8_t* end = frame + kBodyAt + body_size;
  put16(end, check);
  memset(end + 2, gen::FRAME_PAD_BYTE, pad);
  end[2 + pad] = gen::TAIL_0;
  end[3 + pad] = gen::TAIL_1;
  return size;
}

}  // namespace hexwire
