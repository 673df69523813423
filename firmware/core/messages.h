// Messages in fragments, one to the board and one from it (PROTOCOL.md section 6.10): whose they are, and how far they are.
// A board has no room for their content, so this has none. Must not know what a message does.
#ifndef HEXWIRE_MESSAGES_H
#define HEXWIRE_MESSAGES_H

#include <stdint.h>

#include "bytes.h"
#include "generated.h"

namespace hexwire {

// A FRAGMENT of a host.
struct Chunk {
  int32_t src;
  uint16_t id;
  uint16_t index;
  uint16_t count;
  uint8_t cmd;
  uint8_t size;
  const uint8_t* data;

  // From a body that is long enough.
  static Chunk parse(int32_t src, const uint8_t* body, uint8_t size) {
    return Chunk{src,
                 get16(body + gen::FRAGMENT_REQUEST_MESSAGE_ID),
                 get16(body + gen::FRAGMENT_REQUEST_INDEX),
                 get16(body + gen::FRAGMENT_REQUEST_COUNT),
                 body[gen::FRAGMENT_REQUEST_CMD],
                 static_cast<uint8_t>(size - gen::FRAGMENT_REQUEST_SIZE),
                 body + gen::FRAGMENT_REQUEST_CHUNK};
  }
  // The seq of the request that the message is.
  uint8_t seq() const { return static_cast<uint8_t>(id); }
};

// The fields of both. All begin as zero: together in a struct, they are cleared by one loop instead of one by one.
struct InboxFields {
  uint8_t state_;
  uint8_t cmd_;
  uint8_t size_;    // of chunk 0
  int32_t src_;
  uint16_t id_;
  uint16_t count_;
  uint16_t next_;
  uint16_t asked_;  // the first chunk that has not been asked for
  uint16_t left_;
  uint32_t used_ms_;
  uint32_t asked_ms_;
};

struct OutboxFields {
  bool open_;
  uint8_t chunks_;
  uint8_t wanted_;  // bit per chunk
  uint8_t number_;
  int32_t src_;
  uint16_t id_;
  uint32_t sent_ms_;
};

// The message to the board that is under way, or the last one.
class Inbox : private InboxFields {
 public:
  Inbox() : InboxFields() {}

  bool open() const { return state_ == kOpen; }
  bool open_for_another(int32_t src) const { return open() && src_ != src; }
  bool is(const Chunk& chunk) const { return open() && same(chunk) && count_ == chunk.count; }
  bool was(const Chunk& chunk, uint32_t now_ms) const {
    return state_ == kDone && same(chunk) && now_ms - used_ms_ <= gen::FRAGMENT_LIFETIME_MS;
  }
  int32_t src() const { return src_; }
  uint16_t id() const { return id_; }
  uint8_t cmd() const { return cmd_; }
  uint8_t seq() const { return static_cast<uint8_t>(id_); }
  uint16_t left() const { return left_; }  // bytes of the body that are still to come

  // Begins a message of `whole` bytes with its chunk 0; false if the lengths do not agree.
  bool begin(const Chunk& chunk, uint16_t whole, uint32_t now_ms) {
    if (chunk.size == 0 || chunk.size > whole || chunk.count != (static_cast<uint32_t>(whole) + chunk.size - 1) / chunk.size) return false;
    state_ = kOpen;
    src_ = chunk.src;
    id_ = chunk.id;
    cmd_ = chunk.cmd;
    count_ = chunk.count;
    size_ = chunk.size;
    left_ = whole;
    next_ = 0;
    asked_ = 1;
    used_ms_ = asked_ms_ = now_ms;
    return true;
  }
  bool expects(const Chunk& chunk) const { return chunk.index == next_; }
  bool right_size(const Chunk& chunk) const { return chunk.size == (left_ < size_ ? left_ : size_); }
  // A chunk has been used.
  void used(uint8_t size, uint32_t now_ms) {
    left_ = static_cast<uint16_t>(left_ - size);
    ++next_;
    used_ms_ = now_ms;
  }
  bool complete() const { return left_ == 0; }
  void close() { state_ = kNone; }
  void finish() { state_ = kDone; }

  // The next question: when it is due, and the indices that it names.
  bool must_ask() const { return next_ == asked_; }
  bool should_ask_again(uint32_t now_ms) const {
    return open() && now_ms - used_ms_ >= gen::FRAGMENT_AGAIN_MS && now_ms - asked_ms_ >= gen::FRAGMENT_AGAIN_MS;
  }
  uint8_t ask(uint16_t* first, uint32_t now_ms) {
    const uint16_t rest = static_cast<uint16_t>(count_ - next_);
    const uint8_t asked = rest < kMostAsked ? static_cast<uint8_t>(rest) : kMostAsked;
    *first = next_;
    asked_ = static_cast<uint16_t>(next_ + asked);
    asked_ms_ = now_ms;
    return asked;
  }
  bool expired(uint32_t now_ms) const { return open() && now_ms - used_ms_ > gen::FRAGMENT_LIFETIME_MS; }

 private:
  static constexpr uint8_t kMostAsked = 2;  // that many fit into the queue
  static constexpr uint8_t kNone = 0, kOpen = 1, kDone = 2;

  bool same(const Chunk& chunk) const { return src_ == chunk.src && id_ == chunk.id && cmd_ == chunk.cmd; }

};

// The reply of the board that it sends in fragments, and sends again where a host missed one.
class Outbox : private OutboxFields {
 public:
  Outbox() : OutboxFields() {}

  bool open() const { return open_; }
  bool open_for_another(int32_t src) const { return open_ && src_ != src; }
  bool is(int32_t src, uint16_t id) const { return open_ && src_ == src && id_ == id; }
  uint16_t id() const { return id_; }
  uint8_t seq() const { return static_cast<uint8_t>(id_); }
  uint8_t chunks() const { return chunks_; }

  void begin(int32_t src, uint8_t seq, uint8_t chunks, uint32_t now_ms) {
    open_ = true;
    src_ = src;
    id_ = static_cast<uint16_t>(seq | (++number_ << 8));
    chunks_ = chunks;
    wanted_ = static_cast<uint8_t>((1U << chunks) - 1);
    sent_ms_ = now_ms;
  }
  void want(uint16_t index) {
    if (index < chunks_) wanted_ |= static_cast<uint8_t>(1U << index);
  }
  void want_none() { wanted_ = 0; }
  bool wants_any() const { return wanted_ != 0; }
  // The first chunk that is still to be sent.
  uint8_t wanted() const {
    uint8_t index = 0;
    while (!(wanted_ & (1U << index))) ++index;
    return index;
  }
  void sent(uint8_t index, uint32_t now_ms) {
    wanted_ &= static_cast<uint8_t>(~(1U << index));
    sent_ms_ = now_ms;
  }
  void close() { open_ = false; }
  void forget(int32_t src) {
    if (src_ == src) open_ = false;
  }
  bool expired(uint32_t now_ms) const { return open_ && now_ms - sent_ms_ > gen::FRAGMENT_LIFETIME_MS; }
};

}  // namespace hexwire

#endif  // HEXWIRE_MESSAGES_H
