#include "hot.h"  // first

#include "trajectory.h"

#include "bytes.h"

namespace hexwire {

namespace {

constexpr uint32_t kLeadUs = kTrajectoryLeadMs * 1000UL;

// value * share / 65536, for a share of 0..65536
int32_t part(int32_t value, uint32_t share) {
  const int32_t high = (value >> 16) * static_cast<int32_t>(share);
  const uint32_t low = (static_cast<uint32_t>(value) & 0xFFFF) * share;
  return high + static_cast<int32_t>(low >> 16);
}

// part / whole in 65536ths
uint32_t share_of(uint32_t part_us, uint32_t whole_us) {
  while (whole_us > 0xFFFF) {
    part_us >>= 1;
    whole_us >>= 1;
  }
  return whole_us ? (part_us << 16) / whole_us : 0x10000;
}

}  // namespace

Trajectory::Trajectory(const Settings& settings) : TrajectoryFields(), settings_(settings) {}

// Number of joints of the path below this one, which is its place in a point.
uint8_t Trajectory::place(uint8_t joint) const {
  uint8_t n = 0;
  for (uint8_t i = 0; i < joint; ++i) {
    if (mask_ & only(i)) ++n;
  }
  return n;
}

// Where the n-th point is, counted from the oldest.
uint16_t Trajectory::offset(uint16_t n) const {
  uint16_t at = static_cast<uint16_t>(head_ + n);
  if (at >= capacity_) at = static_cast<uint16_t>(at - capacity_);
  return static_cast<uint16_t>(at * stride_);
}

// The point towards which the joints move.
uint16_t Trajectory::index() const {
  return ran_ ? static_cast<uint16_t>(oldest() + 1) : oldest();
}

void Trajectory::start_at(uint32_t time_us) {
  start_us_ = time_us;
  state_ = gen::TRAJECTORY_WAITING;
}

void Trajectory::run() {
  state_ = gen::TRAJECTORY_RUNNING;
  ran_ = true;
  // Targets are sent ahead of the clock, so the path's clock is ahead as well.
  clock_us_ = start_us_ - kLeadUs;
  in_segment_us_ = 0;
  load_segment();
}

void Trajectory::load_segment() {
  const uint8_t* a = point(0);
  const uint8_t* b = point(1);
  const int32_t ticks = get16(b);
  segment_us_ = static_cast<uint32_t>(ticks) * kTickUs;
  uint8_t at = 2;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(mask_ & only(i))) continue;
    Cubic& cubic = cubics_[i];
    cubic.origin = signed16(a + at);
    const int32_t way = (static_cast<int32_t>(signed16(b + at)) - cubic.origin) * unit();
    cubic.c1 = way;
    cubic.c2 = cubic.c3 = 0;
    if (hermite()) {
      // Velocity times duration; the product fits 32 bits, and 625 is the ticks per second over 16.
      const int32_t v0 = signed16(a + at + 2) * ticks / 625;
      const int32_t v1 = signed16(b + at + 2) * ticks / 625;
      cubic.c1 = v0;
      cubic.c2 = 3 * way - 2 * v0 - v1;
      cubic.c3 = v0 + v1 - 2 * way;
    }
    at = static_cast<uint8_t>(at + size_of_joint());
  }
}

// False at the end of what is there.
bool Trajectory::next_segment() {
  if (count_ <= 2) return false;
  head_ = static_cast<uint16_t>(head_ + 1 == capacity_ ? 0 : head_ + 1);
  --count_;
  in_segment_us_ -= segment_us_;
  behind_ -= get16(point(1));
  load_segment();
  return true;
}

// Time of the path behind the present segment, microseconds.
uint32_t Trajectory::rest() const { return behind_ > 0xFFFFFF ? 0xFFFFFF * kTickUs : behind_ * kTickUs; }

// What is left of the path, microseconds.
uint32_t Trajectory::left() const { return rest() + (segment_us_ - in_segment_us_); }

// How far the path's clock moves meanwhile. Braking lets its rate fall as 1 - 3 u^2 + 2 u^3.
uint32_t Trajectory::path_time(uint32_t passed_us) {
  if (state_ != gen::TRAJECTORY_BRAKING || brake_us_ == 0) return passed_us;
  brake_left_us_ = passed_us < brake_left_us_ ? brake_left_us_ - passed_us : 0;
  const uint32_t u = share_of(brake_us_ - brake_left_us_, brake_us_);
  const int32_t cube = part(part(static_cast<int32_t>(u), u), u);
  const uint32_t share = u - static_cast<uint32_t>(cube - part(cube, u) / 2);
  const uint32_t before = braked_us_;
  braked_us_ = static_cast<uint32_t>(part(static_cast<int32_t>(brake_us_), share));
  // Rounding must not lead back.
  return braked_us_ > before ? braked_us_ - before : 0;
}

void Trajectory::advance(uint32_t now_us) {
  if (at_end_) return;
  // The time of a packet is predicted, so the next one may be a little earlier; the path never goes back.
  if (static_cast<int32_t>(now_us - clock_us_) > 0) {
    move_on(path_time(now_us - clock_us_));
    clock_us_ = now_us;
  }
  share_ = share_of(in_segment_us_, segment_us_);
}

void Trajectory::move_on(uint32_t path_us) {
  in_segment_us_ += path_us;
  while (in_segment_us_ >= segment_us_) {
    if (next_segment()) continue;
    in_segment_us_ = segment_us_;
    at_end_ = true;
    if (state_ == gen::TRAJECTORY_RUNNING) end_ = complete_ ? gen::TRAJECTORY_DONE : gen::TRAJECTORY_DRY;
    return;
  }
  if (state_ == gen::TRAJECTORY_BRAKING) {
    at_end_ = brake_us_ && brake_left_us_ == 0;
  } else if (!complete_ && left() <= brake_us_ / 2) {
    run_dry();
  }
}

// Braking began a little while ago, when what is left was as long as it needs. Since then the rate has fallen.
void Trajectory::run_dry() {
  const uint32_t late = brake_us_ / 2 - left();
  if (late >= kLeadUs) return brake(gen::TRAJECTORY_DRY);  // the host has taken points away
  begin_braking(gen::TRAJECTORY_DRY);
  const uint32_t too_far = late - path_time(late);
  in_segment_us_ -= too_far < in_segment_us_ ? too_far : in_segment_us_;
}

int16_t Trajectory::position(uint8_t joint) const {
  const Cubic& cubic = cubics_[joint];
  int32_t way = hermite() ? part(cubic.c2 + part(cubic.c3, share_), share_) : 0;
  way = part(cubic.c1 + way, share_);
  return static_cast<int16_t>((static_cast<int32_t>(cubic.origin) * unit() + way + 8) >> 4);
}

void Trajectory::brake(uint8_t end_state) {
  if (state_ == gen::TRAJECTORY_BRAKING) {
    // A fault is always told.
    if (end_state == gen::TRAJECTORY_FAULT) end_ = end_state;
    return;
  }
  if (!moving()) return end(end_state);
  // Where no more is left than braking takes, all of it: at the path's own speed, if it leads to its end.
  if (left() <= brake_us_ / 2) brake_us_ = complete_ ? 0 : 2 * left();
  begin_braking(end_state);
}

void Trajectory::begin_braking(uint8_t end_state) {
  state_ = gen::TRAJECTORY_BRAKING;
  end_ = end_state;
  brake_left_us_ = brake_us_;
  braked_us_ = 0;
}

void Trajectory::end(uint8_t state) {
  if (ready() || moving()) state_ = state;
}

}  // namespace hexwire
