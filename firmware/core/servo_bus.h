// The master of the half-duplex servo line: one transaction at a time, non-blocking (PROTOCOL.md section 4).
// Owns the line's two buffers, the removal of an echo, the search for answers, timeouts and retries.
// Must not know joints, registers or hosts.
#ifndef HEXWIRE_SERVO_BUS_H
#define HEXWIRE_SERVO_BUS_H

#include <stdint.h>

#include "frame.h"
#include "generated.h"
#include "platform.h"
#include "stats.h"

namespace hexwire {

enum class BusResult : uint8_t {
  kOk,
  kSilent,   // no bytes arrived
  kDamaged,  // bytes arrived, but no valid answer
};

constexpr uint8_t kAnyHeader = 0;
constexpr uint8_t kAnyLength = 0xFF;
constexpr uint8_t kNoAnswer = 0xFF;

// Criteria for the answer to the packet that is sent.
struct Expect {
  uint8_t header;      // second byte, 0xFF or 0xF5; kAnyHeader
  uint8_t parameters;  // of each status packet; kAnyLength
  bool ping;           // the answer has 6 bytes whatever its length byte says
  uint8_t tries;
  uint16_t timeout_us;  // from the end of the request to the first byte of the answer
};

class ServoBus {
 public:
  static constexpr uint8_t kMaxPacket = kMaxBody;  // the longest that fits into a host's frame
  static constexpr uint8_t kMaxAnswer = 160;
  static constexpr uint16_t kByteUs = 87;  // at 115200

  ServoBus(Platform& platform, Stats& stats);

  // Starts a packet in the send buffer. Then `add` parameters and call one of the `start_` functions.
  void begin(uint8_t id, uint8_t instruction);
  void add(uint8_t byte) { packet_[size_++] = byte; }
  void add16(uint16_t value, bool big_endian);
  // Alternatively, puts a complete packet into the send buffer unchanged.
  void take(const uint8_t* packet, uint8_t size);

  void start_silent();
  void start_single(const Expect& expect);
  // One status packet from each of `ids`, in any order.
  void start_many(const uint8_t* ids, uint8_t count, const Expect& expect);
  // `reply_length` bytes, whatever they are.
  void start_raw(uint8_t reply_length, uint32_t timeout_us);

  void poll(uint32_t now);
  // Time that the packet in the send buffer takes on the line.
  uint16_t line_us() const { return static_cast<uint16_t>(size_ * kByteUs); }
  bool idle() const { return state_ == State::kIdle; }
  // True once for each transaction that was started, when it has ended.
  bool finished();
  // Ends the transaction as soon as the line allows: a packet being sent and an answer being received
  // are completed, but nothing else is awaited.
  void hurry(uint32_t now);

  BusResult result() const { return result_; }
  // Status packet number `index` of the answer (raw: all bytes received); null if it is missing.
  const uint8_t* answer(uint8_t index = 0) const;
  uint8_t answer_size(uint8_t index = 0) const;

 private:
  enum class State : uint8_t { kIdle, kQuiet, kSending, kWaiting, kFinished };
  enum class Kind : uint8_t { kSilent, kPackets, kRaw };

  void close_packet();
  void start(Kind kind);
  void send();
  void wait_for_quiet();
  void receive();
  void take_byte(uint8_t byte, bool may_be_echo);
  void search();
  bool complete() const;
  bool match_at(uint8_t at);
  bool right_header(const uint8_t* packet) const;
  bool right_length(uint8_t length) const;
  uint8_t awaited(uint8_t id) const;
  bool only_an_echo() const { return echo_over_ && echo_matched_ == size_ && received_ == 0; }
  void check_end();
  void fail();
  void finish(BusResult result);

  Platform& platform_;
  Stats& stats_;
  State state_;
  Kind kind_;
  BusResult result_;
  Expect expect_;
  bool line_dirty_;   // the last transaction may still have bytes on the way
  bool echo_seen_;    // the adapter echoes, as seen in the last transaction that showed it
  bool hurried_;
  bool whole_;        // the packet came with its checksum
  uint8_t size_;
  uint8_t tries_left_;
  uint8_t raw_length_;
  uint8_t echo_matched_;  // bytes of the request echoed so far
  bool echo_over_;        // no more bytes can be part of the echo
  uint8_t received_;
  uint8_t searched_;      // bytes of `answer_` that are already searched
  uint8_t wanted_;        // number of status packets
  uint8_t got_;
  uint32_t timeout_us_;
  uint32_t now_;      // time of the present pass
  uint32_t since_;    // start of the state; while waiting, the end of the request
  uint32_t last_rx_;
  uint32_t hurried_at_;
  uint8_t ids_[gen::MAX_JOINTS];
  uint8_t at_[gen::MAX_JOINTS];
  uint8_t packet_[kMaxPacket];
  uint8_t answer_[kMaxAnswer];
};

}  // namespace hexwire

#endif  // HEXWIRE_SERVO_BUS_H
