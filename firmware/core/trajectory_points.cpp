// The points of a path: what a host may add, and where it is kept. trajectory.cpp has how the joints follow them.
#include <string.h>

#include "bytes.h"
#include "trajectory.h"

namespace hexwire {

namespace {

constexpr uint16_t kTicksPerSecond = 10000;
constexpr uint8_t kFine = 8;  // parts of a count

}  // namespace

void Trajectory::begin(uint8_t id, uint8_t flags, Mask mask, uint16_t brake_ms) {
  id_ = id;
  state_ = gen::TRAJECTORY_LOADING;
  flags_ = flags;
  mask_ = mask;
  complete_ = ran_ = at_end_ = staging_ = false;
  stride_ = static_cast<uint8_t>(2 + place(kJoints) * size_of_joint());
  capacity_ = static_cast<uint16_t>(kRoom / stride_);
  head_ = count_ = next_ = 0;
  brake_us_ = brake_ms * 1000UL;
  behind_ = 0;
}

uint8_t Trajectory::add(const uint8_t* points, uint8_t size, uint16_t first, uint8_t count, bool last) {
  if (count == 0 || size != static_cast<uint16_t>(count) * stride_) return gen::STATUS_BAD_LENGTH;
  // Points that are there from `first` on are replaced.
  const uint16_t kept = static_cast<uint16_t>(first - oldest());
  if (!may_follow(kept)) return gen::STATUS_BAD_RANGE;
  const uint8_t* before = kept ? point(static_cast<uint16_t>(kept - 1)) : nullptr;
  for (uint8_t n = 0; n < count; ++n) {
    const uint8_t* each = points + n * stride_;
    const uint8_t status = check_point(each, before);
    if (status != gen::STATUS_OK) return status;
    before = each;
  }
  if (staging_ || count > capacity_ - kept) return gen::STATUS_BUSY;
  while (count_ > kept) drop_last();
  for (uint8_t n = 0; n < count; ++n) store(points + n * stride_);
  complete_ = last;
  return gen::STATUS_OK;
}

uint8_t Trajectory::stage(uint16_t first, uint8_t count, bool last) {
  if (first != next_ || !may_follow(count_)) return gen::STATUS_BAD_RANGE;
  if (count > capacity_ - count_) return gen::STATUS_BUSY;
  staging_ = true;
  staged_last_ = last;
  staged_ = begun_ = 0;
  return gen::STATUS_OK;
}

// The bytes go to where the points will be, since no other points come meanwhile. There is room for all of them.
uint8_t Trajectory::take(const uint8_t* bytes, uint8_t size) {
  if (!staging_ || !may_follow(count_)) return gen::STATUS_BAD_RANGE;
  while (size) {
    const uint16_t n = static_cast<uint16_t>(count_ + staged_);
    const uint8_t lacking = static_cast<uint8_t>(stride_ - begun_);
    const uint8_t taken = size < lacking ? size : lacking;
    memcpy(place_of(n) + begun_, bytes, taken);
    begun_ = static_cast<uint8_t>(begun_ + taken);
    bytes += taken;
    size = static_cast<uint8_t>(size - taken);
    if (taken < lacking) break;
    const uint8_t status = check_point(point(n), n ? point(static_cast<uint16_t>(n - 1)) : nullptr);
    if (status != gen::STATUS_OK) return status;
    ++staged_;
    begun_ = 0;
  }
  return gen::STATUS_OK;
}

void Trajectory::commit() {
  for (; staged_; --staged_) count_in();
  complete_ = staged_last_;
  staging_ = false;
}

// Whether further points may follow the oldest `kept` ones.
bool Trajectory::may_follow(uint16_t kept) const {
  if (kept > count_ || (kept == count_ && complete_)) return false;
  // The joints already move towards the second one.
  return ready() || (state_ == gen::TRAJECTORY_RUNNING && kept >= 2);
}

void Trajectory::drop_last() {
  if (count_ > 2) behind_ -= get16(point(static_cast<uint16_t>(count_ - 1)));
  --count_;
  --next_;
}

uint8_t Trajectory::check_point(const uint8_t* now, const uint8_t* before) const {
  const uint16_t dt = get16(now);
  if ((dt == 0) != (before == nullptr)) return gen::STATUS_BAD_RANGE;
  uint8_t at = 2;
  for (uint8_t i = 0; i < kJoints; ++i) {
    if (!(mask_ & only(i))) continue;
    const uint8_t status = check_joint(i, now + at, before ? before + at : nullptr, dt);
    if (status != gen::STATUS_OK) return status;
    at = static_cast<uint8_t>(at + size_of_joint());
  }
  return gen::STATUS_OK;
}

uint8_t Trajectory::check_joint(uint8_t i, const uint8_t* now, const uint8_t* before, uint16_t dt) const {
  const int16_t position = signed16(now);
  const int32_t parts = fine() ? kFine : 1;  // of a count
  if (position < settings_.minimum(i) * parts || position > settings_.maximum(i) * parts) return gen::STATUS_BAD_RANGE;
  const int32_t limit = settings_.speed(i);
  const int32_t velocity = hermite() ? signed16(now + 2) : 0;
  if (velocity > limit || velocity < -limit) return gen::STATUS_BAD_RANGE;
  if (before == nullptr) return gen::STATUS_OK;
  const int32_t way = static_cast<int32_t>(position) - signed16(before);
  // One less, since positions are rounded.
  const uint32_t least = static_cast<uint32_t>(way > 0 ? way - 1 : way < 0 ? -way - 1 : 0);
  const bool fast = least * (fine() ? kTicksPerSecond / kFine : kTicksPerSecond) > static_cast<uint32_t>(limit) * dt;
  return fast ? gen::STATUS_BAD_RANGE : gen::STATUS_OK;
}

void Trajectory::store(const uint8_t* added) {
  memcpy(place_of(count_), added, stride_);
  count_in();
}

// Makes the point behind the newest one of the path.
void Trajectory::count_in() {
  // The segment between the two oldest points is counted apart.
  if (count_ >= 2) behind_ += get16(point(count_));
  ++count_;
  ++next_;
}

bool Trajectory::enough() const {
  if (count_ < 2) return false;
  return complete_ || rest() + get16(point(1)) * static_cast<uint32_t>(kTickUs) > brake_us_ / 2;
}

int16_t Trajectory::origin(uint8_t joint) const {
  const int16_t position = signed16(point(0) + 2 + place(joint) * size_of_joint());
  return fine() ? static_cast<int16_t>((static_cast<int32_t>(position) + kFine / 2) >> 3) : position;
}

}  // namespace hexwire
