#include "host_rate.h"

#include "generated.h"

namespace hexwire {

namespace {

constexpr uint8_t kOwnCode = 0;
constexpr uint8_t kMostCode = 4;
constexpr uint8_t kLastBytesMs = 2;  // what the chip holds besides its ring, with a margin

}  // namespace

HostRate::HostRate(Platform& platform)
    : platform_(platform), phase_(Phase::kOwn), code_(kOwnCode), next_(kOwnCode), since_ms_(0) {}

uint32_t HostRate::rate_of(uint8_t code) const {
  switch (code) {
    case 1:
      return 115200;
    case 2:
      return 250000;
    case 3:
      return 500000;
    case kMostCode:
      return 1000000;
    default:
      return own();
  }
}

bool HostRate::known(uint32_t rate) const {
  uint8_t code = kOwnCode;
  while (code <= kMostCode && rate_of(code) != rate) ++code;
  return code <= kMostCode;
}

void HostRate::change(uint32_t rate) {
  next_ = kOwnCode;
  while (rate_of(next_) != rate) ++next_;
  phase_ = Phase::kSending;
}

void HostRate::heard(uint32_t now_ms) {
  if (phase_ == Phase::kTrial) phase_ = Phase::kRaised;
  if (phase_ == Phase::kRaised) since_ms_ = static_cast<uint16_t>(now_ms);
}

bool HostRate::poll(uint32_t now_ms) {
  const uint16_t passed = static_cast<uint16_t>(static_cast<uint16_t>(now_ms) - since_ms_);
  switch (phase_) {
    case Phase::kSending:
      if (platform_.host_write_waiting()) return false;
      phase_ = Phase::kLastBytes;
      since_ms_ = static_cast<uint16_t>(now_ms);
      return false;
    case Phase::kLastBytes:
      if (passed < kLastBytesMs) return false;
      return set(next_, next_ == kOwnCode ? Phase::kOwn : Phase::kTrial, now_ms);
    case Phase::kTrial:
      return passed >= gen::HOST_BAUD_TRIAL_MS && set(kOwnCode, Phase::kOwn, now_ms);
    case Phase::kRaised:
      return passed >= gen::HOST_BAUD_SILENCE_MS && set(kOwnCode, Phase::kOwn, now_ms);
    default:
      return false;
  }
}

bool HostRate::set(uint8_t code, Phase phase, uint32_t now_ms) {
  code_ = code;
  phase_ = phase;
  since_ms_ = static_cast<uint16_t>(now_ms);
  platform_.set_host_rate(rate_of(code));
  return true;
}

}  // namespace hexwire
