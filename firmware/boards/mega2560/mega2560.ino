// The Hex7Bot controller on an Arduino Mega 2560. Open this folder in the Arduino IDE, or run
// `make -C firmware mega2560`. The board's behaviour is in src/core; this file has only what the chip needs.
// Wiring and flashing: docs/firmware.md.

#include <avr/eeprom.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <util/delay.h>

#include "src/core/board.h"
#include "src/core/boot_counter.h"
#include "uart.h"

#ifndef HEXWIRE_HOST_BAUD
#define HEXWIRE_HOST_BAUD 115200
#endif
#ifndef HEXWIRE_BUS_BAUD
#define HEXWIRE_BUS_BAUD 115200
#endif

namespace {

constexpr uint8_t kPumpPin = 40;
constexpr uint8_t kValvePin = 36;
constexpr uint8_t kBuzzerPin = 37;

class Mega : public hexwire::Platform {
 public:
  uint32_t micros() override { return ::micros(); }
  uint16_t host_read(uint8_t* into, uint16_t room) override { return host_uart_read(into, room); }
  uint16_t host_write_room() override { return host_uart_room(); }
  uint16_t host_write_waiting() override { return host_uart_waiting(); }
  void host_write(const uint8_t* data, uint16_t size) override { host_uart_write(data, size); }
  uint32_t host_own_rate() override { return HEXWIRE_HOST_BAUD; }
  void set_host_rate(uint32_t rate) override { host_uart_rate(rate); }
  uint8_t bus_read(uint8_t* into, uint8_t room) override { return bus_uart_read(into, room); }
  void bus_write(const uint8_t* data, uint8_t size) override { bus_uart_write(data, size); }
  bool bus_sending() override { return bus_uart_sending(); }
  void bus_release() override { _delay_us(25); }
  void host_expect(uint8_t bytes) override { host_uart_expect(bytes); }
  void bus_expect(uint8_t bytes) override { bus_uart_expect(bytes); }
  uint8_t storage_read(uint16_t address) override {
    return eeprom_read_byte(reinterpret_cast<const uint8_t*>(address));
  }
  bool storage_ready() override { return eeprom_is_ready(); }
  void storage_write(uint16_t address, uint8_t value) override {
    eeprom_write_byte(reinterpret_cast<uint8_t*>(address), value);
  }
  void set_outputs(uint8_t value) override {
    digitalWrite(kPumpPin, value & 1);
    digitalWrite(kValvePin, value & 2);
    digitalWrite(kBuzzerPin, value & 4);
  }
};

Mega platform;
hexwire::Board board(platform);

uint8_t reset_cause __attribute__((section(".noinit")));

}  // namespace

// After a watchdog reset the watchdog is still running, with its shortest time-out: stop it before anything else.
// If a boot loader has cleared MCUSR by then, the cause is unknown.
void note_reset() __attribute__((naked, used, section(".init3")));
void note_reset() {
  reset_cause = MCUSR;
  MCUSR = 0;
  wdt_disable();
}

// A second tick of 1.024 ms, beside the Arduino core's: it wakes the loop for time-outs and reports.
ISR(TIMER0_COMPA_vect) { uart_work = true; }

void setup() {
  pinMode(kPumpPin, OUTPUT);
  pinMode(kValvePin, OUTPUT);
  pinMode(kBuzzerPin, OUTPUT);
  uint8_t flags = 0;
  if (reset_cause & _BV(BORF)) flags |= hexwire::gen::BOARD_FLAG_UNDER_VOLTAGE_RESET;
  if (reset_cause & _BV(WDRF)) flags |= hexwire::gen::BOARD_FLAG_WATCHDOG_RESET;
  const uint32_t boot_id = hexwire::next_boot_id(platform);
  uart_begin(HEXWIRE_HOST_BAUD, HEXWIRE_BUS_BAUD);
  board.begin(boot_id, flags);
  OCR0A = 128;
  TIMSK0 |= _BV(OCIE0A);
  set_sleep_mode(SLEEP_MODE_IDLE);
  wdt_enable(WDTO_250MS);
}

void loop() {
  wdt_reset();
  if (!board.poll()) return;
  // Sleep until there is work. The instruction after sei() is always executed before an interrupt, so none
  // can occur between the check and the sleep.
  cli();
  while (!uart_work) {
    sleep_enable();
    sei();
    sleep_cpu();
    sleep_disable();
    cli();
  }
  uart_work = false;
  sei();
}
