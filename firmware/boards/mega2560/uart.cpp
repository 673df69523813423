#include "uart.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

volatile bool uart_work;

namespace {

// Sizes are powers of two, so that an index wraps by a mask.
constexpr uint16_t kHostIn = 512;
constexpr uint16_t kHostOut = 512;
constexpr uint8_t kBusIn = 128;

uint8_t host_in[kHostIn];
volatile uint16_t host_in_head;
volatile uint16_t host_in_tail;

uint8_t host_out[kHostOut];
volatile uint16_t host_out_head;
volatile uint16_t host_out_tail;

uint8_t bus_in[kBusIn];
volatile uint8_t bus_in_head;
volatile uint8_t bus_in_tail;

volatile uint8_t host_in_wanted;
volatile uint8_t bus_in_wanted;

// The program is notified when this many bytes are left to send on the host line.
constexpr uint8_t kNearlyFree = 16;

const uint8_t* volatile bus_out;
volatile uint8_t bus_out_left;
volatile bool bus_out_busy;

uint16_t divisor(uint32_t baud) { return static_cast<uint16_t>((F_CPU / 4 / baud - 1) / 2); }

uint16_t host_out_used() {
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { return (host_out_head - host_out_tail) & (kHostOut - 1); }
  return 0;
}

}  // namespace

// A byte that arrives while its ring is full is lost; the frame check or the servo checksum detects that.
ISR(USART0_RX_vect) {
  const uint8_t byte = UDR0;
  const uint16_t head = host_in_head;
  const uint16_t next = (head + 1) & (kHostIn - 1);
  if (next == host_in_tail) return;
  host_in[head] = byte;
  host_in_head = next;
  if (host_in_wanted > 1) {
    --host_in_wanted;
  } else {
    uart_work = true;
  }
}

ISR(USART0_UDRE_vect) {
  const uint16_t tail = host_out_tail;
  UDR0 = host_out[tail];
  const uint16_t next = (tail + 1) & (kHostOut - 1);
  host_out_tail = next;
  const uint16_t left = (host_out_head - next) & (kHostOut - 1);
  if (left == kNearlyFree) uart_work = true;
  if (left == 0) UCSR0B &= static_cast<uint8_t>(~_BV(UDRIE0));
}

ISR(USART1_RX_vect) {
  const uint8_t byte = UDR1;
  const uint8_t next = (bus_in_head + 1) & (kBusIn - 1);
  if (next == bus_in_tail) return;
  bus_in[bus_in_head] = byte;
  bus_in_head = next;
  if (bus_in_wanted > 1) {
    --bus_in_wanted;
  } else {
    uart_work = true;
  }
}

ISR(USART1_UDRE_vect) {
  const uint8_t* p = bus_out;
  UDR1 = *p;
  bus_out = p + 1;
  if (--bus_out_left == 0) {
    // The line is busy until the last stop bit, when the transmit-complete interrupt comes. Its flag may still be set
    // from an earlier byte, so it is cleared once the last byte is in the data register.
    UCSR1A |= _BV(TXC1);
    UCSR1B = static_cast<uint8_t>((UCSR1B & ~_BV(UDRIE1)) | _BV(TXCIE1));
  }
}

ISR(USART1_TX_vect) {
  UCSR1B &= static_cast<uint8_t>(~_BV(TXCIE1));
  bus_out_busy = false;
  uart_work = true;
}

void uart_begin(uint32_t host_baud, uint32_t bus_baud) {
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    // 8N1, double speed: 115200 comes out as 117647 (+2.1 %), 500000 is exact.
    UCSR0A = _BV(U2X0);
    UBRR0 = divisor(host_baud);
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
    UCSR1A = _BV(U2X1);
    UBRR1 = divisor(bus_baud);
    UCSR1C = _BV(UCSZ11) | _BV(UCSZ10);
    UCSR1B = _BV(RXEN1) | _BV(TXEN1) | _BV(RXCIE1);
  }
}

void host_uart_rate(uint32_t baud) {
  const uint16_t next = divisor(baud);
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { UBRR0 = next; }
}

uint16_t host_uart_read(uint8_t* into, uint16_t room) {
  uint16_t head;
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { head = host_in_head; }
  uint16_t tail = host_in_tail;
  uint16_t count = 0;
  while (count < room && tail != head) {
    into[count++] = host_in[tail];
    tail = (tail + 1) & (kHostIn - 1);
  }
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { host_in_tail = tail; }
  return count;
}

uint16_t host_uart_room() { return kHostOut - 1 - host_out_used(); }

uint16_t host_uart_waiting() { return host_out_used(); }

void host_uart_write(const uint8_t* data, uint16_t size) {
  uint16_t head = host_out_head;
  for (uint16_t i = 0; i < size; ++i) {
    host_out[head] = data[i];
    head = (head + 1) & (kHostOut - 1);
  }
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    host_out_head = head;
    UCSR0B |= _BV(UDRIE0);
  }
}

uint8_t bus_uart_read(uint8_t* into, uint8_t room) {
  const uint8_t head = bus_in_head;
  uint8_t tail = bus_in_tail;
  uint8_t count = 0;
  while (count < room && tail != head) {
    into[count++] = bus_in[tail];
    tail = (tail + 1) & (kBusIn - 1);
  }
  bus_in_tail = tail;
  return count;
}

void bus_uart_write(const uint8_t* data, uint8_t size) {
  if (size == 0) return;
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    bus_out = data;
    bus_out_left = size;
    bus_out_busy = true;
    UCSR1B |= _BV(UDRIE1);
  }
}

bool bus_uart_sending() { return bus_out_busy; }

// Bytes that are already in the ring count.
void host_uart_expect(uint8_t bytes) {
  ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
    const uint16_t held = (host_in_head - host_in_tail) & (kHostIn - 1);
    host_in_wanted = bytes > held ? static_cast<uint8_t>(bytes - held) : 1;
    if (held >= bytes) uart_work = true;
  }
}

void bus_uart_expect(uint8_t bytes) { bus_in_wanted = bytes; }
