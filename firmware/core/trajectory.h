// A path that a host sent ahead: its points, where it is at any time, and how it comes to rest (PROTOCOL.md, 6.7).
// Owns the points and the path's own clock. Must not know the servo line, hosts, or whether a joint can move.
#ifndef HEXWIRE_TRAJECTORY_H
#define HEXWIRE_TRAJECTORY_H

#include <stdint.h>

#include "generated.h"
#include "joints.h"
#include "settings.h"

namespace hexwire {

constexpr uint8_t kTrajectoryLeadMs = 24;  // a little more than the time between two targets of a joint
constexpr uint8_t kTickUs = 100;           // the unit of the times of points
constexpr uint16_t kLeastBrakeMs = 20;
constexpr uint16_t kMostBrakeMs = 2000;

// The fields of a trajectory. All begin as zero. Together in a struct, they are cleared by one loop instead of one by one.
struct TrajectoryFields {
  static constexpr uint16_t kRoom = 64 * (2 + 4 * kJoints);  // 64 points of all joints with velocities

  struct Cubic {
    int16_t origin;      // as in the point
    int32_t c1, c2, c3;  // sixteenths of a count
  };

  uint8_t id_;
  uint8_t state_;
  uint8_t end_;     // the state after braking
  uint8_t flags_;
  Mask mask_;
  bool complete_;   // the last point has arrived
  bool ran_;
  bool at_end_;     // its position does not change any more
  uint8_t stride_;  // bytes of a point
  uint16_t capacity_;
  uint16_t head_;   // place of the oldest point
  uint16_t count_;
  uint16_t next_;   // index of the point after the newest
  bool staging_;
  bool staged_last_;
  uint8_t staged_;  // whole points behind the newest that do not count yet
  uint8_t begun_;   // bytes of the one after them
  uint32_t brake_us_;  // 0 while braking: it follows the path to its end
  uint32_t brake_left_us_;
  uint32_t braked_us_;  // how far the path's clock has moved since braking began
  uint32_t start_us_;
  uint32_t clock_us_;    // up to when the path's clock was moved on
  uint32_t segment_us_;  // the segment between the two oldest points
  uint32_t in_segment_us_;
  uint32_t share_;       // of the segment that is over, in 65536ths
  uint32_t behind_;      // time of the path after this segment, in 0.1 ms
  Cubic cubics_[kJoints];
  uint8_t points_[kRoom];
};

class Trajectory : private TrajectoryFields {
 public:
  explicit Trajectory(const Settings& settings);

  // A new one; the former is forgotten.
  void begin(uint8_t id, uint8_t flags, Mask mask, uint16_t brake_ms);
  // Adds points in the format of the line. Returns a status code; unless it is ok, nothing is added.
  uint8_t add(const uint8_t* points, uint8_t size, uint16_t first, uint8_t count, bool last);

  // The same for points that come in pieces: their bytes are taken one after the other, and count when `commit` is called.
  uint8_t stage(uint16_t first, uint8_t count, bool last);
  uint8_t take(const uint8_t* bytes, uint8_t size);
  void commit();
  void drop_staged() { staging_ = false; }
  bool staging() const { return staging_; }
  uint8_t stride() const { return stride_; }

  uint8_t id() const { return id_; }
  uint8_t state() const { return state_; }
  Mask joints() const { return mask_; }
  bool moving() const { return state_ == gen::TRAJECTORY_RUNNING || state_ == gen::TRAJECTORY_BRAKING; }
  bool ready() const { return state_ == gen::TRAJECTORY_LOADING || state_ == gen::TRAJECTORY_WAITING; }
  bool outlives_host() const { return moving() && complete_ && (flags_ & gen::TRAJECTORY_FLAG_OUTLIVES_HOST); }
  uint16_t capacity() const { return capacity_; }
  uint16_t next() const { return next_; }
  uint16_t index() const;
  uint16_t free() const { return static_cast<uint16_t>(capacity_ - count_); }

  // Whether there is enough of it to start: all of it, or more than braking needs.
  bool enough() const;
  // Position of a joint at point 0, before the start.
  int16_t origin(uint8_t joint) const;
  void start_at(uint32_t time_us);
  bool waits() const { return state_ == gen::TRAJECTORY_WAITING; }
  // Microseconds until the start; negative when it has come.
  int32_t until_start(uint32_t now_us) const { return static_cast<int32_t>(start_us_ - now_us); }
  void run();

  // Moves the path's clock on to a time.
  void advance(uint32_t now_us);
  // Position of a joint of it on the path now.
  int16_t position(uint8_t joint) const;

  // Its position does not change any more; `finish` ends it, when the joints are there.
  bool at_end() const { return moving() && at_end_; }
  void finish() { state_ = end_; }

  // Comes to rest on the path, and then is in that state; one that does not move yet ends at once.
  void brake(uint8_t end);
  void end(uint8_t state);

 private:
  bool hermite() const { return flags_ & gen::TRAJECTORY_FLAG_HERMITE; }
  bool fine() const { return flags_ & gen::TRAJECTORY_FLAG_FINE; }
  // Sixteenths of a count in the unit of a position.
  uint8_t unit() const { return fine() ? 2 : 16; }
  uint8_t size_of_joint() const { return hermite() ? 4 : 2; }
  uint16_t oldest() const { return static_cast<uint16_t>(next_ - count_); }
  bool may_follow(uint16_t kept) const;
  void drop_last();
  uint8_t place(uint8_t joint) const;
  uint16_t offset(uint16_t n) const;
  const uint8_t* point(uint16_t n) const { return points_ + offset(n); }
  uint8_t* place_of(uint16_t n) { return points_ + offset(n); }
  uint8_t check_point(const uint8_t* point, const uint8_t* before) const;
  uint8_t check_joint(uint8_t joint, const uint8_t* now, const uint8_t* before, uint16_t dt) const;
  void store(const uint8_t* point);
  void count_in();
  void load_segment();
  bool next_segment();
  uint32_t rest() const;
  void move_on(uint32_t path_us);
  uint32_t path_time(uint32_t passed_us);
  uint32_t left() const;
  void run_dry();
  void begin_braking(uint8_t end);

  const Settings& settings_;
};

}  // namespace hexwire

#endif  // HEXWIRE_TRAJECTORY_H
