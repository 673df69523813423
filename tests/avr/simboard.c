// A Mega 2560 under libsimavr, in simulated time, for ctypes. Test code only: libsimavr is GPL-3.
//
// Owns what libsimavr 1.6 gets wrong about serial lines: a character takes 11 bits there, output appears when
// it begins rather than when it ends, and the receiver never overruns. Here both lines are serialised at
// their own rate, and a byte that finds the chip's two-deep receive buffer and its shift register full is lost.
// While the chip's rate of the host line is not that of the host, every byte arrives as another one.
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <simavr/avr_eeprom.h>
#include <simavr/avr_uart.h>
#include <simavr/avr_watchdog.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_interrupts.h>
#include <simavr/sim_io.h>

#define LINES 2
#define QUEUE 16384
#define FREQUENCY 16000000u
// From the data-register-empty flag to the write to UDR: what the interrupt costs. The chip hides it behind
// its transmit buffer, the simulator has none.
#define LATENCY 60
#define UCSR0A 0xC0
#define UBRR0L 0xC4
#define UBRR0H 0xC5
#define U2X 1
// What makes a byte that is heard at a wrong rate another one. What it is does not matter.
#define WRONG 0x5B

typedef struct {
  uint8_t byte;
  uint64_t end;  // cycle at which its stop bit is over
} character_t;

typedef struct {
  struct board *board;
  avr_uart_t *uart;
  avr_irq_t *input;
  uint32_t byte_cycles;
  uint64_t free_at;  // transmitter: end of the last character
  uint64_t in_free_at;
  character_t in[QUEUE];
  unsigned in_head, in_tail;
  character_t out[QUEUE];
  unsigned out_head, out_tail;
  uint64_t overruns;
  uint64_t written;       // bytes in both directions
  unsigned spoil_every;   // 0, or every so-manieth byte is damaged
  int armed;
} line_t;

typedef struct board {
  avr_t *avr;
  line_t line[LINES];
  void (*core_reset)(avr_t *);
  uint64_t resets;
  int stop;  // something happened that the caller wants to see
} board_t;

static board_t *the_board;  // avr->reset has no place for a parameter

static avr_cycle_count_t feed(avr_t *avr, avr_cycle_count_t when, void *param);

// Cycles that a byte takes by the chip's own setting, of the host line.
static uint32_t chip_cycles(board_t *board) {
  const uint8_t *data = board->avr->data;
  return ((data[UBRR0H] << 8 | data[UBRR0L]) + 1) * 10 * (data[UCSR0A] & 1 << U2X ? 8 : 16);
}

static int heard(line_t *line) {
  if (line != &line->board->line[0]) return 1;
  const int32_t off = (int32_t)chip_cycles(line->board) - (int32_t)line->byte_cycles;
  return (off < 0 ? -off : off) * 20 < (int32_t)line->byte_cycles;
}

// The byte as the other end receives it.
static uint8_t passed(line_t *line, uint8_t byte) {
  line->written++;
  if (line->spoil_every && line->written % line->spoil_every == 0) byte ^= 0x10;
  return heard(line) ? byte : byte ^ WRONG;
}

// Cycles for which the chip's transmitter is busy with a byte.
static uint32_t sending_cycles(line_t *line) { return heard(line) ? line->byte_cycles : chip_cycles(line->board); }

static void no_sleep(avr_t *avr, avr_cycle_count_t cycles) {
  (void)avr;
  (void)cycles;
}

static void arm(line_t *line) {
  avr_t *avr = line->board->avr;
  if (line->armed || line->in_head == line->in_tail) return;
  const uint64_t at = line->in[line->in_tail % QUEUE].end;
  line->armed = 1;
  avr_cycle_timer_register(avr, at > avr->cycle ? at - avr->cycle : 1, feed, line);
}

static avr_cycle_count_t feed(avr_t *avr, avr_cycle_count_t when, void *param) {
  line_t *line = param;
  (void)avr;
  (void)when;
  line->armed = 0;
  if (line->in_head == line->in_tail) return 0;
  const character_t c = line->in[line->in_tail++ % QUEUE];
  const unsigned held = (line->uart->input.write - line->uart->input.read) & 63;
  if (held >= 3) {
    line->overruns++;
  } else {
    // The simulator shows a byte that long after it was put in, and the next one that long after.
    line->uart->cycles_per_byte = 1;
    avr_raise_irq(line->input, passed(line, c.byte));
  }
  arm(line);
  return 0;
}

static void on_output(struct avr_irq_t *irq, uint32_t value, void *param) {
  line_t *line = param;
  (void)irq;
  const uint64_t now = line->board->avr->cycle;
  const uint64_t begin = now > line->free_at ? now : line->free_at;
  line->free_at = begin + sending_cycles(line);
  if (line->out_head - line->out_tail == QUEUE) line->out_tail++;
  line->out[line->out_head % QUEUE].byte = passed(line, (uint8_t)value);
  line->out[line->out_head++ % QUEUE].end = line->free_at;
  line->uart->cycles_per_byte = 1;
  line->board->stop = 1;
}

// Just before the firmware writes a byte: how long the simulated transmitter is to be busy with it.
static void on_transmit(struct avr_irq_t *irq, uint32_t value, void *param) {
  line_t *line = param;
  (void)irq;
  if (!value) return;
  const uint64_t now = line->board->avr->cycle;
  const uint64_t begin = now > line->free_at ? now : line->free_at;
  line->uart->cycles_per_byte = begin + sending_cycles(line) - now - LATENCY;
}

static avr_uart_t *find_uart(avr_t *avr, char name) {
  for (avr_io_t *io = avr->io_port; io; io = io->next) {
    if (strcmp(io->kind, "uart") == 0 && ((avr_uart_t *)io)->name == name) return (avr_uart_t *)io;
  }
  return NULL;
}

static void on_reset(avr_t *avr) {
  board_t *board = the_board;
  if (board->core_reset) board->core_reset(avr);
  board->resets++;
  board->stop = 1;
  for (int i = 0; i < LINES; i++) {
    line_t *line = &board->line[i];
    // All cycle timers are gone, and what was being sent ends in the middle.
    line->armed = 0;
    line->free_at = avr->cycle;
  }
}

board_t *sim_new(const char *elf, uint32_t host_baud, uint32_t bus_baud) {
  elf_firmware_t firmware;
  memset(&firmware, 0, sizeof(firmware));
  // The loader talks to stdout.
  const int out = dup(1), null = open("/dev/null", O_WRONLY);
  dup2(null, 1);
  const int failed = elf_read_firmware(elf, &firmware);
  dup2(out, 1);
  close(out);
  close(null);
  avr_t *avr = failed ? NULL : avr_make_mcu_by_name("atmega2560");
  if (!avr) return NULL;
  board_t *board = calloc(1, sizeof(*board));
  board->avr = avr;
  the_board = board;
  avr_init(avr);
  avr->log = LOG_NONE;
  firmware.frequency = FREQUENCY;
  avr_load_firmware(avr, &firmware);
  avr->frequency = FREQUENCY;
  avr->sleep = no_sleep;
  board->core_reset = avr->reset;
  avr->reset = on_reset;
  for (int i = 0; i < LINES; i++) {
    line_t *line = &board->line[i];
    const char name = (char)('0' + i);
    line->board = board;
    line->uart = find_uart(avr, name);
    line->byte_cycles = FREQUENCY / 8 * 80 / (i ? bus_baud : host_baud);
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS(name), &flags);
    line->input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ(name), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ(name), UART_IRQ_OUTPUT), on_output, line);
    avr_irq_t *vector = avr_get_interrupt_irq(avr, line->uart->udrc.vector);
    avr_irq_register_notify(vector + AVR_INT_IRQ_RUNNING, on_transmit, line);
  }
  return board;
}

void sim_delete(board_t *board) {
  avr_terminate(board->avr);
  free(board);
}

// Runs until `cycle`, or until a byte is sent or the chip resets. Returns the cycle reached; 0 after a crash.
uint64_t sim_run(board_t *board, uint64_t cycle) {
  avr_t *avr = board->avr;
  the_board = board;
  board->stop = 0;
  while (avr->cycle < cycle && !board->stop) {
    const uint64_t left = cycle - avr->cycle;
    avr->run_cycle_limit = left < 1600 ? left : 1600;
    for (int i = 0; i < LINES; i++) arm(&board->line[i]);
    const int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) return 0;
  }
  return avr->cycle;
}

// Sends bytes to the chip, the first one beginning at `begin` or when the line is free.
void sim_put(board_t *board, int line_number, const uint8_t *data, unsigned size, uint64_t begin) {
  line_t *line = &board->line[line_number];
  if (begin < board->avr->cycle) begin = board->avr->cycle;
  if (line->in_free_at < begin) line->in_free_at = begin;
  for (unsigned i = 0; i < size && line->in_head - line->in_tail < QUEUE; i++) {
    line->in_free_at += line->byte_cycles;
    line->in[line->in_head % QUEUE].byte = data[i];
    line->in[line->in_head++ % QUEUE].end = line->in_free_at;
  }
}

// Takes characters whose stop bit is over by `until`.
unsigned sim_get(board_t *board, int line_number, uint8_t *data, uint64_t *ends, unsigned room, uint64_t until) {
  line_t *line = &board->line[line_number];
  unsigned count = 0;
  while (count < room && line->out_tail != line->out_head && line->out[line->out_tail % QUEUE].end <= until) {
    data[count] = line->out[line->out_tail % QUEUE].byte;
    ends[count++] = line->out[line->out_tail++ % QUEUE].end;
  }
  return count;
}

uint64_t sim_cycle(board_t *board) { return board->avr->cycle; }
uint64_t sim_resets(board_t *board) { return board->resets; }
uint64_t sim_in_free(board_t *board, int line_number) { return board->line[line_number].in_free_at; }
uint64_t sim_overruns(board_t *board, int line_number) { return board->line[line_number].overruns; }
void sim_line_rate(board_t *board, int line_number, uint32_t baud) {
  board->line[line_number].byte_cycles = FREQUENCY / 8 * 80 / baud;
}
// Damages every so-manieth byte of a line from now on; 0 ends that.
void sim_spoil(board_t *board, int line_number, unsigned every) { board->line[line_number].spoil_every = every; }
// The rate of the host line that the chip has set, bits per second.
uint32_t sim_chip_rate(board_t *board) { return FREQUENCY * 10ull / chip_cycles(board); }

// The reset button. The cause is an external reset.
void sim_reset(board_t *board) {
  the_board = board;
  avr_reset(board->avr);
  board->avr->data[0x54] = 0x02;  // MCUSR: EXTRF
}

void sim_eeprom(board_t *board, uint16_t offset, uint8_t *data, uint16_t size, int write) {
  avr_eeprom_desc_t d = {.ee = data, .offset = offset, .size = size};
  avr_ioctl(board->avr, write ? AVR_IOCTL_EEPROM_SET : AVR_IOCTL_EEPROM_GET, &d);
}


uint32_t sim_pc(board_t *board) { return board->avr->pc; }
void sim_poke_flash(board_t *board, uint32_t at, uint16_t instruction) {
  board->avr->flash[at] = (uint8_t)instruction;
  board->avr->flash[at + 1] = (uint8_t)(instruction >> 8);
}

uint8_t sim_peek(board_t *board, uint16_t address) { return board->avr->data[address]; }
int sim_sleeping(board_t *board) { return board->avr->state == cpu_Sleeping; }
int sim_in_interrupt(board_t *board) { return board->avr->sreg[S_I] == 0; }
