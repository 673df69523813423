// Requests that wait for the bus, and replies stored for repeats.
// Both are bounded: a full queue refuses, a full store drops its oldest entry. Neither knows what a request means.
#ifndef HEXWIRE_QUEUE_H
#define HEXWIRE_QUEUE_H

#include <stdint.h>
#include <string.h>

#include "bytes.h"
#include "frame.h"
#include "generated.h"

namespace hexwire {

struct Request {
  int32_t src;
  uint8_t proto;
  uint8_t seq;
  uint8_t cmd;
  uint8_t size;
  const uint8_t* body;

  bool same(const Frame& frame) const {
    return proto == frame.proto && src == frame.src && seq == frame.seq && cmd == frame.cmd && size == frame.size &&
           memcmp(body, frame.body, size) == 0;
  }
};

inline Request request_of(const Frame& frame) {
  return Request{frame.src, frame.proto, frame.seq, frame.cmd, frame.size, frame.body};
}

class RequestQueue {
 public:
  RequestQueue() : used_(0), count_(0) {}

  bool push(const Frame& frame) {
    if (count_ == kMost || static_cast<uint16_t>(used_ + kHead + frame.size) > sizeof(bytes_)) return false;
    write(bytes_ + used_, frame);
    return true;
  }

  bool front(Request* request) const {
    if (count_ == 0) return false;
    read(bytes_, request);
    return true;
  }

  void pop() {
    const uint16_t size = static_cast<uint16_t>(kHead + bytes_[kSizeAt]);
    used_ = static_cast<uint16_t>(used_ - size);
    memmove(bytes_, bytes_ + size, used_);
    --count_;
  }

  bool holds(const Frame& frame) const {
    Request request;
    for (uint16_t at = 0; at < used_; at = static_cast<uint16_t>(at + kHead + request.size)) {
      read(bytes_ + at, &request);
      if (request.same(frame)) return true;
    }
    return false;
  }

  uint8_t count() const { return count_; }

 private:
  static constexpr uint8_t kHead = 8;
  static constexpr uint8_t kSizeAt = 7;
  static constexpr uint8_t kMost = 24;

  void write(uint8_t* p, const Frame& frame) {
    put32(p, static_cast<uint32_t>(frame.src));
    p[4] = frame.proto;
    p[5] = frame.seq;
    p[6] = frame.cmd;
    p[kSizeAt] = frame.size;
    if (frame.size) memcpy(p + kHead, frame.body, frame.size);
    used_ = static_cast<uint16_t>(used_ + kHead + frame.size);
    ++count_;
  }

  static void read(const uint8_t* p, Request* request) {
    request->src = static_cast<int32_t>(get32(p));
    request->proto = p[4];
    request->seq = p[5];
    request->cmd = p[6];
    request->size = p[kSizeAt];
    request->body = p + kHead;
  }

  uint16_t used_;
  uint8_t count_;
  uint8_t bytes_[512];
};

class ReplyStore {
 public:
  static constexpr uint8_t kMostReply = 132;  // of what this board answers in one frame

  struct Entry {
    uint32_t at_ms;
    int32_t src;
    bool used;
    uint8_t seq;
    uint8_t cmd;
    uint8_t status;
    uint8_t request_size;
    uint8_t reply_size;
    uint32_t request;  // of its body
    uint8_t reply[kMostReply];
  };

  ReplyStore() : next_(0), entries_() {}

  void add(const Request& request, uint8_t status, const uint8_t* reply, uint8_t size, uint32_t now_ms) {
    Entry& entry = entries_[next_];
    next_ = static_cast<uint8_t>((next_ + 1) % gen::STORED_REPLIES);
    entry.at_ms = now_ms;
    entry.src = request.src;
    entry.used = true;
    entry.seq = request.seq;
    entry.cmd = request.cmd;
    entry.status = status;
    entry.request_size = request.size;
    entry.reply_size = size;
    entry.request = digest(request.body, request.size);
    memcpy(entry.reply, reply, size);
  }

  // Room for a reply that is put together before it is answered; the oldest one makes way.
  uint8_t* scratch() {
    entries_[next_].used = false;
    return entries_[next_].reply;
  }

  // A restarted module restarts its count: none of its requests may be mistaken for a repeat.
  void forget(int32_t src) {
    for (uint8_t i = 0; i < gen::STORED_REPLIES; ++i) {
      if (entries_[i].src == src) entries_[i].used = false;
    }
  }

  const Entry* find(const Frame& frame, uint32_t now_ms) const {
    for (uint8_t i = 0; i < gen::STORED_REPLIES; ++i) {
      const Entry& entry = entries_[i];
      if (!entry.used || entry.seq != frame.seq || entry.cmd != frame.cmd || entry.src != frame.src) continue;
      if (entry.request_size != frame.size || now_ms - entry.at_ms > gen::REPEAT_WINDOW_MS) continue;
      if (entry.request == digest(frame.body, frame.size)) return &entry;
    }
    return nullptr;
  }

 private:
  // Stands for a body, which would take four times 208 bytes: a CRC and, independent of it, a sum of sums.
  static uint32_t digest(const uint8_t* p, uint8_t size) {
    uint16_t sum = 0;
    uint16_t sums = 0;
    for (uint8_t i = 0; i < size; ++i) {
      sum = static_cast<uint16_t>(sum + p[i] + 1);
      sums = static_cast<uint16_t>(sums + sum);
    }
    return (static_cast<uint32_t>(crc16(p, size)) << 16) | sums;
  }

  uint8_t next_;
  Entry entries_[gen::STORED_REPLIES];
};

}  // namespace hexwire

#endif  // HEXWIRE_QUEUE_H
