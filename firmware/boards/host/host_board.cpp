#include "host_board.h"

#include <string.h>

#include <algorithm>

namespace hexwire {

namespace {

const uint32_t kStorageByteUs = 3300;  // write time of the Mega's EEPROM

uint16_t take(std::vector<uint8_t>& from, uint8_t* into, uint16_t room) {
  const size_t count = std::min<size_t>(room, from.size());
  std::copy(from.begin(), from.begin() + static_cast<long>(count), into);
  from.erase(from.begin(), from.begin() + static_cast<long>(count));
  return static_cast<uint16_t>(count);
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
  b->~HostBoard();
  new (b) HostBoard;
  b->storage = storage;
  b->storage_writes = writes;
  b->now_us = now;
  b->bus_byte_us = byte_us;
  b->board.begin(boot_id, reset_flags);
}

// One pass of the core at time `now_us`. True if it has nothing to do before the next byte or millisecond.
int hexwire_poll(HostBoard* b, uint64_t now_us) {
  b->now_us = now_us;
  return b->board.poll();
}

void hexwire_host_in(HostBoard* b, const uint8_t* data, uint32_t size) {
  b->from_host.insert(b->from_host.end(), data, data + size);
}

uint32_t hexwire_host_out(HostBoard* b, uint8_t* into, uint32_t room) {
  return hexwire::take(b->to_host, into, static_cast<uint16_t>(room));
}

void hexwire_bus_in(HostBoard* b, const uint8_t* data, uint32_t size) {
  b->from_bus.insert(b->from_bus.end(), data, data + size);
}

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
