// The core on an ordinary computer: lines are memory, time comes from the caller, storage is an array.
// One class for the shared library, the pseudo-terminal program and the fuzz target.
#ifndef HEXWIRE_HOST_BOARD_H
#define HEXWIRE_HOST_BOARD_H

#include <stdint.h>

#include <map>
#include <vector>

#include "board.h"

namespace hexwire {

// Bytes on their way over the two lines, by the microsecond at which each of them has come. A reset changes nothing here.
struct Lines {
  std::multimap<uint64_t, uint8_t> to_board, bus_to_board;
  uint64_t free_us;    // when the board's last byte to the host is over
  uint32_t host_rate;  // at any other rate of the board's every byte arrives as another one
};

class HostBoard final : public Platform {
 public:
  static const uint16_t kStorageSize = 4096;
  static const uint16_t kHostOut = 511;  // as on the Mega

  HostBoard();

  uint32_t micros() override { return static_cast<uint32_t>(now_us); }
  uint16_t host_read(uint8_t* into, uint16_t room) override;
  uint16_t host_write_room() override { return static_cast<uint16_t>(kHostOut - to_host.size()); }
  uint16_t host_write_waiting() override { return static_cast<uint16_t>(to_host.size()); }
  void host_write(const uint8_t* data, uint16_t size) override;
  uint32_t host_own_rate() override { return 115200; }
  void set_host_rate(uint32_t rate) override { host_rate = rate; }
  uint8_t bus_read(uint8_t* into, uint8_t room) override;
  void bus_write(const uint8_t* data, uint8_t size) override;
  bool bus_sending() override { return now_us < bus_free_us; }
  uint8_t storage_read(uint16_t address) override { return storage[address % kStorageSize]; }
  bool storage_ready() override { return now_us >= storage_free_us; }
  void storage_write(uint16_t address, uint8_t value) override;
  void set_outputs(uint8_t value) override { outputs = value; }

  uint64_t now_us;
  uint32_t bus_byte_us;      // 0 = the bus takes no time
  uint64_t bus_free_us;
  uint64_t storage_free_us;
  bool storage_broken;       // writes are lost
  uint8_t outputs;
  uint32_t host_rate;
  std::vector<uint8_t> from_host, to_host, from_bus, to_bus;
  Lines lines;
  std::vector<uint8_t> storage;
  std::vector<uint32_t> storage_writes;  // of each byte
  Board board;
};

}  // namespace hexwire

#endif  // HEXWIRE_HOST_BOARD_H
