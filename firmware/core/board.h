// The controller: takes requests in both dialects, runs them one after the other, keeps the arm safe.
// Owns the order of things: what is queued, what jumps the queue, what is refused. Time and bytes come from a
// Platform; nothing here waits. PROTOCOL.md sections 5 and 6 say what every command does.
#ifndef HEXWIRE_BOARD_H
#define HEXWIRE_BOARD_H

#include <stdint.h>

#include "frame.h"
#include "generated.h"
#include "joints.h"
#include "platform.h"
#include "poller.h"
#include "queue.h"
#include "servo_bus.h"
#include "settings.h"
#include "stats.h"

namespace hexwire {

constexpr uint8_t kVersionMajor = 1;
constexpr uint8_t kVersionMinor = 0;
constexpr uint8_t kVersionPatch = 0;

// Instructions that change nothing.
inline bool is_read(uint8_t instruction) {
  return instruction == gen::INST_PING || instruction == gen::INST_READ || instruction == gen::INST_SYNC_READ;
}

class Board {
 public:
  explicit Board(Platform& platform);

  // Starts afresh after a reset. `boot_id` is new at every reset; `reset_flags` are bits of the board flags.
  void begin(uint32_t boot_id, uint8_t reset_flags);

  // One pass; call it again and again. True if it may rest until the next interrupt.
  bool poll();

 private:
  // What a job is made of. Sweeps and packets take the bus, the rest happens at once.
  enum class Step : uint8_t {
    kReadPosition,
    kReadTorque,
    kReadTarget,
    kReadCeiling,
    kAimPresent,     // target = where the joint is, for all that answered
    kAimIfTorque,    // the same for joints that have torque
    kAimMove,        // targets of JOINT_MOVE
    kAimSyncWrite,   // targets of SYNC_WRITE
    kSendLegacy,
    kSendHls,
    kSendTorque,
    kSendPacket,
    kSendRaw,
    kConfirmTorque,
    kConfirmTarget,
    kReplyMove,
    kReplySyncWrite,
    kReplyPacket,
    kReplyRaw,
    kAwaitCycle,
    kReplyState,
    kAwaitSaved,
    kBooted,
  };
  enum class Owner : uint8_t { kNobody, kPoller, kJob };

  struct Job {
    bool active;
    bool entered;  // the present step's sweep has begun
    uint8_t pc;
    uint8_t repeats;
    uint8_t cycles;
    const Step* program;
    Mask mask;
    uint8_t argument;  // torque on or off, STOP's mode, fields
    uint16_t duration_ms;
    Targets targets;
  };

  // board.cpp: the way in and out
  void tick();
  void receive();
  void accept(const Frame& frame);
  void check_watchdog();
  void stop(const Frame& frame);
  void send(uint8_t proto, int32_t dst, uint8_t seq, uint8_t cmd, uint8_t ext, uint8_t size);
  uint8_t* body() { return tx_ + kBodyAt; }
  bool may_send() { return platform_.host_write_room() >= gen::MAX_SERIAL_FRAME; }
  void reply(uint8_t status, uint8_t size);
  void reply_chapter(uint8_t size);
  void refuse(uint8_t status) { reply(status, 0); }
  void report();

  // commands.cpp: one function a command
  void execute();
  void execute_chapter();
  void execute_packet();
  void identify();
  void joint_state();
  void set_report();
  void joint_move();
  void torque();
  void resume();
  void watchdog();
  void settings(Block block);
  void transact();
  void stats();
  void io();
  uint8_t put_state(uint8_t fields);
  uint8_t check_packet(const uint8_t* packet, uint8_t size) const;
  void note_write(const uint8_t* packet);
  void note_register(uint8_t servo_id, uint8_t address, const uint8_t* data, uint8_t size);
  bool target_allowed(uint8_t servo_id, uint8_t address, const uint8_t* data, uint8_t size) const;
  uint8_t board_error(uint8_t id, uint8_t error);
  void refuse_packet(uint8_t status);

  // jobs.cpp: what takes the bus
  void start_job(const Step* program, Mask mask);
  void run_job();
  bool run_step();
  bool needs_bus() const;
  bool start_request();
  Mask ceiling_unknown() const;
  void send_packet();
  void send_raw();
  void set_duration(uint8_t joint, uint16_t duration_ms);
  bool sweep(Item item, Mask mask);
  void next_step();
  void drop_job();
  void aim(Mask mask);
  void aim_move();
  void aim_sync_write();
  void put_target(uint8_t joint, int16_t position, uint32_t duration_ms);
  int16_t clamp(uint8_t joint, int32_t wanted);
  uint32_t at_least(uint32_t duration_ms, uint8_t joint, int16_t target) const;
  void confirm(bool target);
  void reply_move();
  void reply_packet();
  void reply_raw();
  Mask torqued() const;
  void run_bus();

  static const Step kBoot[];
  static const Step kMove[];
  static const Step kSyncWrite[];
  static const Step kTorqueOn[];
  static const Step kTorqueOff[];
  static const Step kHold[];
  static const Step kPacket[];
  static const Step kRaw[];
  static const Step kState[];
  static const Step kSave[];

  uint8_t flags() const {
    return static_cast<uint8_t>(board_flags_ | (settings_.is_default() ? gen::BOARD_FLAG_SETTINGS_DEFAULT : 0));
  }
  bool stopped() const { return board_flags_ & gen::BOARD_FLAG_STOPPED; }

  Platform& platform_;
  Stats stats_;
  FrameDecoder decoder_;
  RequestQueue queue_;
  ReplyStore stored_;
  Settings settings_;
  ServoBus bus_;
  Joints joints_;
  Poller poller_;
  Sweep sweep_;
  Job job_;
  Owner owner_;
  Request now_running_;

  uint32_t boot_id_;
  uint8_t board_flags_;
  uint8_t outputs_;

  uint32_t last_us_;  // the clock: microseconds since `sec_`, seconds and milliseconds since reset
  uint32_t us_;
  uint32_t sec_;
  uint32_t ms_;
  uint16_t ms_rest_;

  uint32_t sn_;
  uint8_t report_seq_;
  uint8_t report_fields_;
  int32_t report_to_;
  uint32_t heard_ms_;          // the last valid frame
  bool chapter_heard_;         // a dialect-1 frame came within the last second
  uint32_t chapter_heard_ms_;
  bool fed_;                   // a valid frame came since the watchdog tripped
  uint8_t watchdog_mode_;
  uint16_t watchdog_ms_;

  uint8_t tx_[gen::MAX_SERIAL_FRAME];
};

}  // namespace hexwire

#endif  // HEXWIRE_BOARD_H
