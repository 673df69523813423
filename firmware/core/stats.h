// Counters since reset, in the order of the STATS reply. They only count up.
#ifndef HEXWIRE_STATS_H
#define HEXWIRE_STATS_H

#include <stdint.h>

namespace hexwire {

struct Stats {
  uint32_t frames_received;
  uint32_t frames_sent;
  uint32_t bad_checks;
  uint32_t bad_frames;
  uint32_t resyncs;
  uint32_t bytes_dropped;
  uint32_t repeats;
  uint32_t bus_transactions;
  uint32_t bus_retries;
  uint32_t bus_timeouts;
  uint32_t bus_bad;
  uint32_t watchdog_trips;
  uint32_t queue_high_water;
  uint32_t loop_us_max;
};

}  // namespace hexwire

#endif  // HEXWIRE_STATS_H
