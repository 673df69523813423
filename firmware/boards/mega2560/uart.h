// Two interrupt-driven serial lines: UART0 to the host, UART1 to the servos. They replace the Arduino core's
// Serial and Serial1, whose 64-byte rings lose a frame that arrives while another is worked on.
#ifndef HEXWIRE_UART_H
#define HEXWIRE_UART_H

#include <stdint.h>

void uart_begin(uint32_t host_baud, uint32_t bus_baud);

uint16_t host_uart_read(uint8_t* into, uint16_t room);
uint16_t host_uart_room();
uint16_t host_uart_waiting();
void host_uart_write(const uint8_t* data, uint16_t size);

uint8_t bus_uart_read(uint8_t* into, uint8_t room);
void bus_uart_write(const uint8_t* data, uint8_t size);
bool bus_uart_sending();

// Whether a byte is waiting on either line. Call with interrupts off, just before going to sleep.
bool uart_input_waiting();

#endif  // HEXWIRE_UART_H
