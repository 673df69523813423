// Two interrupt-driven serial lines: UART0 to the host, UART1 to the servos. They replace the Arduino core's
// Serial and Serial1, whose 64-byte ring buffers lose a frame that arrives while another is processed.
#ifndef HEXWIRE_UART_H
#define HEXWIRE_UART_H

#include <stdint.h>

void uart_begin(uint32_t host_baud, uint32_t bus_baud);

void host_uart_rate(uint32_t baud);
uint16_t host_uart_read(uint8_t* into, uint16_t room);
uint16_t host_uart_room();
uint16_t host_uart_waiting();
void host_uart_write(const uint8_t* data, uint16_t size);

uint8_t bus_uart_read(uint8_t* into, uint8_t room);
void bus_uart_write(const uint8_t* data, uint8_t size);
bool bus_uart_sending();

// Number of bytes that must arrive before `uart_work` becomes true.
void host_uart_expect(uint8_t bytes);
void bus_uart_expect(uint8_t bytes);

// An event for the program: the awaited bytes have arrived, a packet to the servos has been sent, or the host line is
// nearly free. The program clears it.
extern volatile bool uart_work;

#endif  // HEXWIRE_UART_H
