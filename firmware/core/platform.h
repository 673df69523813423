// The board's interface to the core. Every call returns at once, but for the pause of `bus_release`; nothing may block.
#ifndef HEXWIRE_PLATFORM_H
#define HEXWIRE_PLATFORM_H

#include <stdint.h>

namespace hexwire {

class Platform {
 public:
  // Free-running microseconds; wraps.
  virtual uint32_t micros() = 0;

  // The host line: received bytes, room for bytes to send, bytes not sent yet.
  virtual uint16_t host_read(uint8_t* into, uint16_t room) = 0;
  virtual uint16_t host_write_room() = 0;
  virtual uint16_t host_write_waiting() = 0;
  virtual void host_write(const uint8_t* data, uint16_t size) = 0;

  // The rate of the host line with which the board starts, bits per second; 0 if the line has none. And another rate; what
  // is being sent may be cut.
  virtual uint32_t host_own_rate() { return 0; }
  virtual void set_host_rate(uint32_t rate) { (void)rate; }

  // The servo line. `data` must not change until `bus_sending` is false, which means the stop bit has been sent.
  virtual uint8_t bus_read(uint8_t* into, uint8_t room) = 0;
  virtual void bus_write(const uint8_t* data, uint8_t size) = 0;
  virtual bool bus_sending() = 0;
  // Waits some 25 us between an answer and the request that is ready to follow it: a servo that is slow to release the
  // line must not meet that request.
  virtual void bus_release() {}

  // Hints for a board that sleeps: it need not wake up before this many more bytes have arrived.
  virtual void host_expect(uint8_t bytes) { (void)bytes; }
  virtual void bus_expect(uint8_t bytes) { (void)bytes; }

  // Memory that survives a reset. A byte may be written while `storage_ready`; before that it waits.
  virtual uint8_t storage_read(uint16_t address) = 0;
  virtual bool storage_ready() = 0;
  virtual void storage_write(uint16_t address, uint8_t value) = 0;

  // The digital outputs of the IO command: bit 0 pump, bit 1 valve, bit 2 buzzer.
  virtual void set_outputs(uint8_t value) = 0;

 protected:
  // Not virtual, since objects are never deleted through this type: a virtual destructor would need the heap.
  ~Platform() {}
};

}  // namespace hexwire

#endif  // HEXWIRE_PLATFORM_H
