// The controller: accepts requests in both dialects, executes them one after the other, keeps the arm safe.
// Owns the order of execution: which requests are queued, jump the queue, or are refused. Time and bytes come from a
// Platform; nothing here blocks. PROTOCOL.md sections 5 and 6 define every command.
#ifndef HEXWIRE_BOARD_H
#define HEXWIRE_BOARD_H

#include <stdint.h>

#include "frame.h"
#include "gate.h"
#include "generated.h"
#include "host_rate.h"
#include "joints.h"
#include "messages.h"
#include "platform.h"
#include "poller.h"
#include "queue.h"
#include "servo_bus.h"
#include "settings.h"
#include "stats.h"
#include "stops.h"
#include "trajectory.h"

namespace hexwire {

// The plain fields of a board. All begin as zero: together in a struct, they are cleared by one loop instead of one by
// one.
struct BoardFields {
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
  bool chapter_heard_;         // a dialect-1 frame arrived within the last second
  uint32_t chapter_heard_ms_;
  bool fed_;                   // a valid frame arrived since the watchdog tripped
  uint8_t watchdog_mode_;
  uint16_t watchdog_ms_;
};

class Board : private BoardFields {
 public:
  explicit Board(Platform& platform);

  // Restarts after a reset. `boot_id` is new at every reset; `reset_flags` are bits of the board flags.
  void begin(uint32_t boot_id, uint8_t reset_flags);

  // One pass; call it repeatedly. Returns true if the chip may sleep until the next interrupt.
  bool poll();

 private:
  friend struct BoardProbe;  // of the fuzz target

  // The steps of a job, in groups: reading, aiming, sending, checking, answering, waiting. Reading and sending use the bus,
  // the other steps are immediate.
  enum class Step : uint8_t {
    kReadPosition,
    kReadStale,        // positions too old to compute a distance from
    kReadTorque,
    kReadUnsure,       // torque that is uncertain
    kReadMode,
    kReadUnknownMode,
    kReadCeiling,
    kReadTarget,
    kReadMoving,       // positions of the joints that a hold still checks
    kReadTaken,        // torque of the joints from which a hold removed it
    kAimPresent,       // target = present position, for all joints that answered
    kAimHold,          // the same for joints that have torque
    kAimMove,          // targets of JOINT_MOVE
    kAimSyncWrite,     // targets of SYNC_WRITE
    kJudgePacket,      // when everything that the gate needs is known
    kSendLegacy,
    kSendHls,
    kSendTorque,
    kSendPacket,
    kSendPacketLegacy, // the host's packet as rewritten by the gate
    kSendPacketHls,
    kTakeOtherMode,    // remove torque from joints in a mode other than position
    kTakeRest,         // and from those that do not hold
    kAskTable,
    kCheckTorque,
    kCheckTarget,
    kNote,
    kPause,
    kCheckStill,
    kFinishHold,
    kEndIfLimp,
    kConfirmTorque,
    kReplyMove,
    kReplySyncWrite,
    kReplyPacket,
    kTakeTable,
    kReplyTable,
    kReplyState,
    kAwaitCycle,
    kSetPathStart,
    kChangeRate,
    kAwaitStorage,
    kAwaitSaved,
    kMaintain,
  };
  enum class Owner : uint8_t { kNobody, kPoller, kJob, kPath };
  enum class Lack : uint8_t { kTorque, kMode, kCeiling };
  enum class For : uint8_t { kRequest, kStop, kBoot };

  struct Job {
    bool active;
    bool entered;  // the present step's sweep has begun
    For owner;
    uint8_t pc;
    uint8_t repeats;
    uint8_t cycles;
    const Step* program;
    Mask mask;
    uint8_t argument;  // torque on or off, STOP's mode, fields
    uint16_t duration_ms;
    Targets targets;
    // Joints of a hold: confirmed without torque, to lose their torque, just deprived of it, still checked.
    Mask limp;
    Mask bad;
    Mask taken;
    Mask moving;
    uint32_t settle_ms;
    uint32_t noted_ms;
    int16_t noted[kJoints];
  };

  // The trajectory's way to the servo line.
  struct Path {
    Mask joints;  // that still follow it
    bool second;  // the targets of the second series are computed
    bool ends;       // the computed targets are the path's last
    bool last_sent;  // the first packet of the last pair has been sent
    uint8_t cycle;
    uint16_t late;
    uint16_t takes_us[2];  // to compute a packet, of legacy servos and of others
    uint16_t pause_us;   // that a servo takes before it answers
    uint32_t begun_us;   // when the poller's last transaction began
    uint32_t aimed_us;   // when a packet that is prepared is expected to begin
    uint32_t written_us;
    uint32_t answered_ms;  // when all joints could be moved
    Targets targets;
  };

  // Registers that a SERVO_TABLE names.
  struct TableRange {
    uint8_t joint;
    uint8_t first;
    uint16_t count;
  };
  enum class TablePhase : uint8_t { kRead, kCompare, kWrite, kVerify };

  // The table that the present job reads or writes.
  struct Table {
    TableRange range;
    TablePhase phase;
    bool in_fragments;    // the reply is
    uint8_t chunk;        // size of the fragment that is written; 0 for a request in one frame
    uint8_t piece;        // registers of the present transaction
    uint8_t filled;       // bytes that have been read
    uint16_t at;          // the next register
    uint16_t end;         // where the frame or chunk ends
    uint8_t* bytes;       // what has been read
    const uint8_t* data;  // what is to be written at `at`
  };

  // board.cpp: input and output
  void tick();
  void receive();
  void accept(const Frame& frame);
  void note_life(const Frame& frame, bool chapter);
  bool is_repeat(const Frame& frame);
  bool refuse_for_several(const Frame& frame);
  bool accept_stop(const Frame& frame);
  void answer(const Frame& frame, uint8_t status, uint8_t size);
  void check_rate();
  void check_watchdog();
  void send(uint8_t proto, int32_t dst, uint8_t seq, uint8_t cmd, uint8_t ext, uint8_t size);
  uint8_t* body() { return tx_ + kBodyAt; }
  bool may_send() { return platform_.host_write_room() >= gen::MAX_SERIAL_FRAME; }
  void reply(uint8_t status, uint8_t size);
  void reply_chapter(uint8_t size);
  void send_chapter(uint8_t size);
  void refuse(uint8_t status) { reply(status, 0); }
  void report();

  // commands.cpp: one function per command
  void execute();
  void execute_other();
  void execute_path();
  void execute_long();
  void execute_chapter();
  void identify();
  void joint_state();
  void set_report();
  void joint_move();
  void torque();
  void resume();
  void watchdog();
  void settings(Block block);
  void stats();
  void io();
  void host_baud();
  void change_rate();
  void maintenance();
  void end_maintenance();
  void reply_maintenance();
  uint8_t put_state(uint8_t fields);
  uint8_t* put_joint(uint8_t* row, const Joint& joint, uint8_t fields) const;

  // packets.cpp: servo packets of a host, through the packet gate and back
  const uint8_t* packet() const;
  uint8_t packet_size() const;
  Gate::Circumstances circumstances() const;
  void pass_packet();
  void pass_move();
  void judge_packet();
  void aim_sync_write();
  void start_packet(bool rewritten);
  bool send_targets(uint8_t series);
  void note_packet(const uint8_t* packet);
  void note_register(uint8_t servo_id, uint8_t address, const uint8_t* data, uint8_t size);
  void note_targets(Mask mask);
  void reply_packet();
  void reply_raw();
  void refuse_packet(uint8_t status);
  uint8_t board_error(uint8_t id, uint8_t error);
  uint8_t silent_servo(const Request& request);

  // stops.cpp: effects of a stop on the servos and on queued requests
  void stop(uint8_t mode);
  bool start_stop();
  void void_next();
  void void_request(const Request& request);
  void answer_stops();
  void finish_stop(uint8_t status, Mask confirmed);
  void aim_hold();
  bool take_torque(Mask mask);
  bool take_back(Mask mask);
  Mask in_other_mode() const;
  void check_torque();
  void check_target();
  void note_positions();
  bool moved_since_note() const;
  void check_still();
  void finish_hold();

  // jobs.cpp: jobs that use the bus
  void start_job(const Step* program, Mask mask);
  bool start_next();
  void run_job();
  bool run_step();
  bool read_step(Step step);
  bool aim_step(Step step);
  bool send_step(Step step);
  bool check_step(Step step);
  bool answer_step(Step step);
  void decide(Step step);
  bool wait_step(Step step);
  bool execute_later();
  bool still_pausing() const;
  bool done();
  bool sent(bool packet);
  bool needs_bus() const;
  bool wants_bus() const { return job_.active && needs_bus(); }
  bool keeps_line_free() const;
  void use_idle_line();
  void take_result(bool may_go_on);
  bool may_go_on() const;
  bool launch_prepared();
  void went_on();
  void prepare_next();
  Mask asked(Step step) const;
  bool sweep(Item item, Mask mask);
  void next_step();
  void back_to(Step step);
  void begin_again();
  bool try_again();
  void drop_job();
  void run_bus();

  // moves.cpp: targets of the joints
  Mask lacking(Lack what) const;
  Mask stale() const;
  void skip_reads();
  Mask torqued() const;
  void aim(Mask mask);
  bool make_targets(uint8_t series);
  void aim_move();
  uint32_t aim_row(uint8_t id, int16_t wanted, uint32_t duration);
  bool can_move(uint8_t joint) const;
  void confirm_torque();
  void reply_torque(bool on, uint8_t status, Mask confirmed);
  void reply_move();
  bool reply_saved();
  void enter_maintenance();

  // paths.cpp: the trajectory
  void begin_path();
  void add_to_path();
  void start_path();
  void set_path_start();
  void path_status();
  void reply_path_status();
  void abort_path();
  uint8_t check_path_start() const;
  bool path_starts_soon() const;
  void leave_path(Mask mask);
  void end_path();
  void watch_path();
  bool path_due() const;
  bool prepare_path();
  bool path_goes_on() const;
  void note_pause();
  void path_went_on();
  bool write_path();
  void begin_pair();
  Mask lost_joints();
  bool send_second();
  bool aim_and_send(uint8_t series);
  void aim_path(uint8_t series, uint32_t time_us);
  bool follows_path(uint8_t joint) const;
  bool send_path_targets(uint8_t series);
  bool make_path_targets(uint8_t series);
  Mask path_joints() const { return trajectory_.moving() ? trajectory_.joints() : 0; }

  // fragments.cpp: messages that come in fragments
  void take_fragment();
  void answer_for(uint8_t cmd, uint8_t seq);
  bool is_void(const Request& request) const;
  void pass_over();
  void ask_for(int32_t src, uint16_t id, uint16_t first, uint8_t count);
  void ask_on();
  void confirm_again(const Chunk& chunk);
  void begin_message(const Chunk& chunk);
  void use_chunk(const Chunk& chunk);
  void begin_points(const Chunk& chunk);
  void use_points(const uint8_t* points, uint8_t size, uint8_t of_chunk);
  bool chunk_used(uint8_t size);
  void end_message(uint8_t status);
  void drop_message();
  void forget_messages(int32_t src);
  void void_messages();
  void void_message(int32_t src, uint8_t seq, uint8_t cmd);
  void watch_messages();

  // tables.cpp: registers of a servo
  bool find_table(const uint8_t* p, TableRange* range) const;
  void servo_table();
  void read_table(const TableRange& range);
  bool path_is_near() const;
  void read_chunk();
  void start_reading();
  void send_again();
  uint8_t may_write_table() const;
  void begin_table(const Chunk& chunk);
  void use_table(const Chunk& chunk);
  void write_table(const TableRange& range, uint16_t at, const uint8_t* data, uint8_t size);
  void table_written();
  void fail_table(uint8_t status);
  void ask_table();
  void take_table();
  bool reply_table();
  uint8_t* put_fragment(uint8_t* p, uint8_t index) const;

  static const Step kBoot[];
  static const Step kMove[];
  static const Step kSyncWrite[];
  static const Step kTorqueOn[];
  static const Step kTorqueOff[];
  static const Step kHold[];
  static const Step kPass[];
  static const Step kSteer[];
  static const Step kGrant[];
  static const Step kState[];
  static const Step kLater[];
  static const Step kSave[];
  static const Step kToMaintenance[];
  static const Step kStartPath[];
  static const Step kToRate[];
  static const Step kTable[];

  uint8_t flags() const {
    return static_cast<uint8_t>(board_flags_ | (settings_.is_default() ? gen::BOARD_FLAG_SETTINGS_DEFAULT : 0));
  }
  bool stopped() const { return board_flags_ & gen::BOARD_FLAG_STOPPED; }
  bool in_maintenance() const { return board_flags_ & gen::BOARD_FLAG_MAINTENANCE; }

  Platform& platform_;
  HostRate rate_;
  Stats stats_;
  FrameDecoder decoder_;
  RequestQueue queue_;
  ReplyStore stored_;
  StopList stops_;
  VoidedStore voided_;
  uint8_t void_left_;  // requests at the head of the queue that a stop has voided
  Settings settings_;
  ServoBus bus_;
  Joints joints_;
  Gate gate_;
  Sweep::Raw raw_[kJoints];
  Poller poller_;
  Sweep sweep_;
  Job job_;
  Trajectory trajectory_;
  Path path_;
  Inbox inbox_;
  Outbox outbox_;
  Table table_;
  TableRange sent_table_;      // that the outbox is about
  TableRange received_table_;  // that the inbox is about
  Owner owner_;
  Owner next_owner_;  // of what is prepared
  Request now_running_;

  uint8_t tx_[gen::MAX_SERIAL_FRAME];
};

}  // namespace hexwire

#endif  // HEXWIRE_BOARD_H
