// Fuzz target: whatever arrives on either line, in whatever pieces, the board reads and writes only its own
// memory, never hangs, never moves a joint while it is stopped, and still answers IDENTIFY afterwards.
#include <stdlib.h>
#include <string.h>

#include "../boards/host/host_board.h"
#include "bytes.h"

namespace {

using namespace hexwire;

void run(HostBoard& b, uint32_t us) {
  for (const uint64_t end = b.now_us + us; b.now_us < end; b.now_us += 200) b.board.poll();
}

// Gets past the check that a fuzzer cannot guess: the piece becomes command and body of a sound frame.
void put_framed(std::vector<uint8_t>& line, const uint8_t* data, size_t size, uint8_t proto, uint8_t seq) {
  if (size == 0 || size > kMaxBody) return;
  uint8_t frame[gen::MAX_SERIAL_FRAME + 4];
  memcpy(frame + kBodyAt, data + 1, size - 1);
  const FrameHead head = {0, 0, 0, 7, gen::MODULE_ARM_7BOT_ARDUINO_TRX, proto, seq, data[0], 0};
  const uint8_t whole = finish_frame(frame, head, static_cast<uint8_t>(size - 1));
  line.insert(line.end(), frame, frame + whole);
}

// The same for a status packet: id, error, parameters.
void put_status(std::vector<uint8_t>& line, const uint8_t* data, size_t size) {
  if (size < 2 || size > 40) return;
  std::vector<uint8_t> packet = {0xFF, static_cast<uint8_t>(data[0] < 4 ? 0xF5 : 0xFF), data[0], static_cast<uint8_t>(size)};
  packet.insert(packet.end(), data + 1, data + size);
  packet.push_back(servo_checksum(&packet[2], static_cast<uint8_t>(packet.size() - 2)));
  line.insert(line.end(), packet.begin(), packet.end());
}

void identify(HostBoard& b) {
  uint8_t frame[gen::MAX_SERIAL_FRAME];
  const FrameHead head = {0, 0, 0, 0, gen::MODULE_ARM_7BOT_ARDUINO_TRX, gen::PROTO_HEXWIRE, 0x5C, gen::CMD_IDENTIFY, 0};
  const uint8_t size = finish_frame(frame, head, 0);
  b.from_host.insert(b.from_host.end(), frame, frame + size);
}

// A write to the torque switch or the target while stopped must take torque away or hold, nothing else.
bool raises_torque(const std::vector<uint8_t>& bus) {
  for (size_t i = 0; i + 8 < bus.size(); ++i) {
    const uint8_t* p = &bus[i];
    if (p[0] != 0xFF || p[1] != 0xFF || p[2] != gen::BROADCAST_ID || p[4] != gen::INST_SYNC_WRITE) continue;
    if (p[5] == gen::HLS_REG_TORQUE_ENABLE && p[6] == 1 && p[8] == 1) return true;
  }
  return false;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  HostBoard b;
  uint8_t seq = 0;
  b.board.begin(1, 0);
  // Each piece: a byte that says which line, whether sound or raw, and how long to run; a length; the bytes.
  while (size >= 2) {
    const uint8_t control = data[0];
    const size_t count = data[1] < size - 2 ? data[1] : size - 2;
    std::vector<uint8_t>& line = control & 1 ? b.from_bus : b.from_host;
    if (!(control & 2)) {
      line.insert(line.end(), data + 2, data + 2 + count);
    } else if (control & 1) {
      put_status(line, data + 2, count);
    } else {
      put_framed(line, data + 2, count, control & 4 ? gen::PROTO_CHAPTER : gen::PROTO_HEXWIRE, ++seq);
    }
    data += 2 + count;
    size -= 2 + count;
    run(b, 200u << (control >> 4));
    b.to_host.clear();
    b.to_bus.clear();
  }
  // Let everything end: pending requests, time-outs, an unfinished frame, a half-written setting.
  for (int i = 0; i < 20; ++i) {
    run(b, 50000);
    b.to_host.clear();
    b.to_bus.clear();
  }
  uint8_t stop[gen::MAX_SERIAL_FRAME];
  stop[kBodyAt] = 1;
  const FrameHead head = {0, 0, 0, 77, gen::MODULE_ARM_7BOT_ARDUINO_TRX, gen::PROTO_HEXWIRE, 1, gen::CMD_STOP, 0};
  const uint8_t stop_size = finish_frame(stop, head, 1);
  b.from_host.insert(b.from_host.end(), stop, stop + stop_size);
  run(b, 300000);
  b.to_host.clear();
  if (raises_torque(b.to_bus)) abort();
  b.to_bus.clear();
  identify(b);
  // A host waits that long. The board's own watchdog may just be stopping an arm whose servos are all silent.
  run(b, gen::DIALECT2_REPLY_WINDOW_MS * 1000u);
  if (b.to_host.size() < gen::FRAME_OVERHEAD) abort();
  const std::vector<uint8_t>& out = b.to_host;
  bool answered = false;
  for (size_t i = 0; i + kBodyAt <= out.size(); ++i) {
    if (get32(&out[i]) == gen::SYNC && out[i + 38] == gen::CMD_IDENTIFY && out[i + 34] == 0x5C) answered = true;
  }
  if (!answered) abort();
  return 0;
}
