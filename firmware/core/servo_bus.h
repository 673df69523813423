// The master of the half-duplex servo line: one transaction at a time, non-blocking (PROTOCOL.md section 4).
// Owns the line's two buffers, the removal of an echo, the search for answers, timeouts and retries. While a transaction
// runs, the next one may be put together, so that it can begin at once.
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

// The fields of a bus. Nearly all begin as zero: together in a struct, they are cleared by one loop instead of one by one.
struct ServoBusFields {
  enum class State : uint8_t { kIdle, kQuiet, kSending, kWaiting, kFinished };
  enum class Kind : uint8_t { kSilent, kPackets, kRaw };

  // What a packet is, and what comes back.
  struct Plan {
    Kind kind;
    uint8_t size;
    uint8_t wanted;  // number of status packets
    uint8_t answer;  // their bytes, if they are known before
    Expect expect;
  };

  State state_;
  Kind kind_;
  BusResult result_;
  Expect expect_;
  bool line_dirty_;   // the last transaction may still have bytes on the way
  bool echo_seen_;    // the adapter echoes, as seen in the last transaction that showed it
  bool hurried_;
  bool whole_;        // the packet came with its checksum
  bool prepared_;
  uint8_t size_;
  uint8_t tries_left_;
  uint8_t raw_length_;
  uint8_t echo_matched_;  // bytes of the request echoed so far
  bool echo_over_;        // no more bytes can be part of the echo
  uint8_t received_;
  uint8_t whole_answer_;
  uint8_t searched_;      // bytes of `answer_` that are already searched
  uint8_t wanted_;
  uint8_t got_;
  uint8_t half_size_;     // of a packet whose beginning is found, 0 if there is none; and which of the awaited ones it is
  uint8_t half_index_;
  uint8_t made_size_;
  Plan next_;
  uint32_t timeout_us_;
  uint32_t now_;      // time of the present pass
  uint32_t since_;    // start of the state; while waiting, the end of the request
  uint32_t last_rx_;
  uint32_t hurried_at_;
};

class ServoBus : private ServoBusFields {
 public:
  static constexpr uint8_t kMaxPacket = kMaxBody;  // the longest that fits into a host's frame
  static constexpr uint8_t kMaxAnswer = 160;
  static constexpr uint8_t kMostPrepared = kMaxPacket / 2;
  static constexpr uint16_t kByteUs = 87;  // at 115200

  ServoBus(Platform& platform, Stats& stats);

  // Begins a packet. Then `add` parameters and call one of the `start_` functions. If a transaction runs that was put
  // together with `begin`, the packet is only prepared, of at most `kMostPrepared` bytes.
  void begin(uint8_t id, uint8_t instruction);
  void add(uint8_t byte) { made_[made_size_++] = byte; }
  void add16(uint16_t value, bool big_endian);
  // Alternatively, puts a complete packet into the send buffer unchanged.
  void take(const uint8_t* packet, uint8_t size);

  void start_silent();
  void start_single(const Expect& expect);
  // One status packet from each of the servos that a SYNC_READ names, in any order.
  void start_many(uint8_t count, const Expect& expect);
  // `reply_length` bytes, whatever they are.
  void start_raw(uint8_t reply_length, uint32_t timeout_us);

  // Whether a transaction is prepared. `launch` puts its packet on the line, which must be idle; false if the line is not
  // quiet. The answer of the transaction before stays readable until `follow`, which must come next.
  bool prepared() const { return prepared_; }
  bool launch();
  void follow();
  void forget_prepared() { prepared_ = false; }

  void poll(uint32_t now);
  // Whether the answer lacks its last byte only, which may come at any moment; and waits for it, about 0.1 ms, so that
  // what follows can begin at once.
  bool ends_soon() const { return state_ == State::kWaiting && received_ + 1 == whole_answer_; }
  void await_end();
  // Time that the packet takes on the line, and that the answer takes without the servos' pauses.
  uint16_t line_us() const { return static_cast<uint16_t>(size_ * kByteUs); }
  uint16_t answer_us() const { return static_cast<uint16_t>(whole_answer_ * kByteUs); }
  uint8_t answers() const { return wanted_; }
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
  void close_packet();
  void start(Kind kind, uint8_t wanted, const Expect& expect);
  uint8_t answer_bytes(Kind kind, uint8_t wanted, const Expect& expect) const;
  bool drop_input();
  void send();
  void note_sent();
  void wait_for_quiet();
  void receive();
  void take_byte(uint8_t byte, bool may_be_echo);
  void search();
  bool complete() const;
  bool match_at(uint8_t at);
  void take_half();
  bool right_header(const uint8_t* packet) const;
  bool right_length(uint8_t length) const;
  uint8_t awaited(uint8_t id) const;
  bool only_an_echo() const { return echo_over_ && echo_matched_ == size_ && received_ == 0; }
  void check_end();
  void fail();
  void finish(BusResult result);

  Platform& platform_;
  Stats& stats_;
  uint8_t* packet_;  // on the line
  uint8_t* made_;    // being made; the other half of the buffer if one is on the line
  uint8_t at_[gen::MAX_JOINTS];
  uint8_t packets_[kMaxPacket];
  uint8_t answer_[kMaxAnswer];
};

}  // namespace hexwire

#endif  // HEXWIRE_SERVO_BUS_H
