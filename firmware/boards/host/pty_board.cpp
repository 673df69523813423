// The core as a program: the host line is a pseudo-terminal whose name is printed first; the servo line is another
// one, or the serial port given with --bus. With a bus adapter, a computer becomes the controller.
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "host_board.h"

namespace {

volatile sig_atomic_t ended = 0;

void on_signal(int) { ended = 1; }

uint64_t now_us() {
  timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return static_cast<uint64_t>(t.tv_sec) * 1000000u + static_cast<uint64_t>(t.tv_nsec) / 1000u;
}

// The slave stays open here, so that the line survives a host that closes the port.
int open_pty(const char* what) {
  int master;
  int slave;
  char name[128];
  termios raw;
  memset(&raw, 0, sizeof(raw));
  cfmakeraw(&raw);
  if (openpty(&master, &slave, name, &raw, nullptr) != 0) {
    fprintf(stderr, "cannot open a pseudo-terminal: %s\n", strerror(errno));
    return -1;
  }
  printf("%s %s\n", what, name);
  fcntl(master, F_SETFL, O_NONBLOCK);
  return master;
}

int open_port(const char* name) {
  const int fd = open(name, O_RDWR | O_NOCTTY | O_NONBLOCK);
  termios raw;
  if (fd < 0 || tcgetattr(fd, &raw) != 0) {
    fprintf(stderr, "cannot open %s: %s\n", name, strerror(errno));
    return -1;
  }
  cfmakeraw(&raw);
  cfsetspeed(&raw, B115200);
  tcsetattr(fd, TCSANOW, &raw);
  return fd;
}

void read_into(int fd, std::vector<uint8_t>& into) {
  uint8_t chunk[256];
  const ssize_t count = read(fd, chunk, sizeof(chunk));
  if (count > 0) into.insert(into.end(), chunk, chunk + count);
}

void write_from(int fd, std::vector<uint8_t>& from) {
  if (from.empty()) return;
  const ssize_t count = write(fd, from.data(), from.size());
  if (count > 0) from.erase(from.begin(), from.begin() + count);
}

// Passes bytes between the lines and the board until a signal arrives.
void serve(int host, int bus, bool real_bus) {
  hexwire::HostBoard board;
  // A pseudo-terminal takes no time: an answer may arrive at once.
  if (!real_bus) board.bus_byte_us = 0;
  const uint64_t start = now_us();
  board.board.begin(static_cast<uint32_t>(time(nullptr)), 0);
  while (!ended) {
    pollfd lines[2] = {{host, POLLIN, 0}, {bus, POLLIN, 0}};
    poll(lines, 2, 1);
    if (lines[0].revents & POLLIN) read_into(host, board.from_host);
    if (lines[1].revents & POLLIN) read_into(bus, board.from_bus);
    board.now_us = now_us() - start;
    board.board.poll();
    write_from(bus, board.to_bus);
    write_from(host, board.to_host);
  }
}

}  // namespace

int main(int argc, char** argv) {
  const char* bus_name = nullptr;
  if (argc == 3 && strcmp(argv[1], "--bus") == 0) {
    bus_name = argv[2];
  } else if (argc != 1) {
    fprintf(stderr, "usage: pty_board [--bus DEVICE]\n");
    return 2;
  }
  signal(SIGINT, on_signal);
  signal(SIGTERM, on_signal);
  const int host = open_pty("host");
  const int bus = bus_name ? open_port(bus_name) : open_pty("bus");
  if (host < 0 || bus < 0) return 1;
  fflush(stdout);
  serve(host, bus, bus_name != nullptr);
  return 0;
}
