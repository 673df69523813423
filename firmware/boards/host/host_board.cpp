#include "host_board.h"

#include <string.h>

#include <algorithm>

namespace hexwire {

namespace {

const uint32_t kStorageByteUs = 3300;  // write time of the Mega's EEPROM
const uint8_t kWrong = 0x5B;           // makes another byte of one that is heard at a wrong rate

uint16_t take(std::vector<uint8_t>& from, uint8_t* into, uint16_t room) {
  const size_t count = std::min<size_t>(room, from.size());
  std::copy(from.begin(), from.begin() + static_cast<long>(count), into);
  from.erase(from.begin(), from.begin() + static_cast<long>(count));
  return static_cast<uint16_t>(count);
}

// A byte of the host line as the other end hears it.
uint8_t passed(const HostBoard& b, uint8_t byte) { 
  return b.host_rate == b.lines.host_rate ? byte : static_cast<uint8_t>(byte ^ kWrong);
}

void deliver(HostBoard& b, uint64_t now_us) {
  auto &host = b.lines.to_board, &bus = b.lines.bus_to_board;
  for (; !host.empty() && host.begin()->first <= now_us; host.erase(host.begin())) {
    b.from_host.push_back(passed(b, host.begin()->second));
  }
  for (; !bus.empty() && bus.begin()->first <= now_us; bus.erase(bus.begin())) {
    b.from_bus.push_back(bus.begin()->second);
  }
}

}  // namespace

HostBoard::HostBoard()
    : now_us(0),
      bus_byte_us(87),
      bus_free_us(0),
      storage_free_us(0),
      storage_broken(false),
      outputs(0),
      host_rate(115200),
      lines(),
      storage(kStorageSize, 0xFF),
      storage_writes(kStorageSize, 0),
      board(*this) {}

uint16_t HostBoard::host_read(uint8_t* into, uint16_t room) { return take(from_host, into, room); }

void HostBoard::host_write(const uint8_t* data, uint16_t size) { to_host.insert(to_host.end(), data, data + size); }

uint8_t HostBoard::bus_read(uint8_t* into, uint8_t room) { return static_cast<uint8_t>(take(from_bus, into, room)); }

void HostBoard::bus_write(const uint8_t* data, uint8_t size) {
  to_bus.insert(to_bus.end(), data, data + size);
  bus_free_us = now_us + static_cast<uint64_t>(bus_byte_us) * size;
}

void HostBoard::storage_write(uint16_t address, uint8_t value) {
  if (!storage_broken) storage[address % kStorageSize] = value;
  ++storage_writes[address % kStorageSize];
  storage_free_us = now_us + kStorageByteUs;
}

}  // namespace hexwire

// The shared library's interface: plain C, for ctypes.
extern "C" {

using hexwire::HostBoard;

HostBoard* hexwire_new() { return new HostBoard; }
void hexwire_delete(HostBoard* b) { delete b; }

void hexwire_begin(HostBoard* b, uint32_t boot_id, uint8_t reset_flags) {
  // A reset: only storage survives.
  std::vector<uint8_t> storage = b->storage;
  std::vector<uint32_t> writes = b->storage_writes;
  const uint64_t now = b->now_us;
  const uint32_t byte_us = b->bus_byte_us;
  const hexwire::Lines lines = b->lines;
  b->~HostBoard();
  new (b) HostBoard;
  b->storage = storage;
  b->storage_writes = writes;
  b->now_us = now;
  b->bus_byte_us = byte_us;
  b->lines = lines;
  b->board.begin(boot_id, reset_flags);
}

// Lets time pass to `end_us`, one pass of the core each `step_us`, or until the board sends on the bus. Returns the time
// reached. `out` gets `*count` bytes that came on the host line and `ends` when each of them was over, as there is room.
uint64_t hexwire_run(HostBoard* b, uint64_t now_us, uint64_t end_us, uint32_t step_us, uint8_t* out, uint64_t* ends,
                     uint32_t room, uint32_t* count) {
  for (*count = 0; now_us < end_us && b->to_bus.empty() && *count < room;) {
    now_us = std::min(now_us + step_us, end_us);
    hexwire::deliver(*b, now_us);
    b->now_us = now_us;
    b->board.poll();
    // A byte at a time, so that the firmware sees its output ring drain as on the chip.
    if (now_us < b->lines.free_us || !hexwire::take(b->to_host, &out[*count], 1)) continue;
    b->lines.free_us = now_us + (10000000 + b->host_rate / 2) / b->host_rate;
    out[*count] = hexwire::passed(*b, out[*count]);
    ends[(*count)++] = b->lines.free_us;
  }
  return now_us;
}

// Puts bytes on the host line that are over at these times.
void hexwire_host_put(HostBoard* b, const uint8_t* data, const uint64_t* ends, uint32_t size) {
  for (uint32_t i = 0; i < size; ++i) b->lines.to_board.insert({ends[i], data[i]});
}

// The same for the bus.
void hexwire_bus_put(HostBoard* b, const uint8_t* data, const uint64_t* ends, uint32_t size) {
  for (uint32_t i = 0; i < size; ++i) b->lines.bus_to_board.insert({ends[i], data[i]});
}

// The rate of the host's end of the host line.
void hexwire_line_rate(HostBoard* b, uint32_t rate) { b->lines.host_rate = rate; }

uint32_t hexwire_bus_out(HostBoard* b, uint8_t* into, uint32_t room) {
  return hexwire::take(b->to_bus, into, static_cast<uint16_t>(room));
}

// When the last byte given to the bus is sent.
uint64_t hexwire_bus_free(HostBoard* b) { return b->bus_free_us; }
uint8_t* hexwire_storage(HostBoard* b) { return b->storage.data(); }
// How often each of its bytes has been written.
uint32_t* hexwire_storage_writes(HostBoard* b) { return b->storage_writes.data(); }
void hexwire_storage_broken(HostBoard* b, int broken) { b->storage_broken = broken != 0; }
uint32_t hexwire_host_rate(HostBoard* b) { return b->host_rate; }
uint8_t hexwire_outputs(HostBoard* b) { return b->outputs; }

}  // extern "C"
