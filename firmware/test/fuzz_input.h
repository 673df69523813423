// How the fuzz target reads its input: as numbers, commands and whole servo packets. Owns no state of a board.
#ifndef HEXWIRE_FUZZ_INPUT_H
#define HEXWIRE_FUZZ_INPUT_H

#include <stddef.h>
#include <stdint.h>

#include <algorithm>
#include <vector>

#include "bytes.h"
#include "generated.h"

namespace hexwire {

const uint8_t kCommands[] = {gen::CMD_IDENTIFY, gen::CMD_JOINT_STATE, gen::CMD_REPORT,   gen::CMD_JOINT_MOVE,
                             gen::CMD_TORQUE,   gen::CMD_WATCHDOG,    gen::CMD_LIMITS,   gen::CMD_OFFSETS,
                             gen::CMD_STATS,    gen::CMD_FRAGMENT,    gen::CMD_IO,       gen::CMD_MAINTENANCE,
                             gen::CMD_TRANSACT, gen::CMD_READ,        gen::CMD_SYNC_WRITE, gen::CMD_PING,
                             gen::CMD_TRAJECTORY_BEGIN, gen::CMD_TRAJECTORY_POINTS, gen::CMD_TRAJECTORY_START,
                             gen::CMD_TRAJECTORY_STATUS, gen::CMD_TRAJECTORY_ABORT, gen::CMD_FRAGMENT_MISSING,
                             gen::CMD_SERVO_TABLE, gen::CMD_HOST_BAUD};
const uint8_t kInstructions[] = {gen::INST_PING,    gen::INST_READ,   gen::INST_WRITE,       gen::INST_REG_WRITE,
                                 gen::INST_ACTION,  gen::INST_RESTORE, gen::INST_REBOOT,     gen::INST_BACKUP,
                                 gen::INST_RESET_STATE, gen::INST_CALIBRATE, gen::INST_SYNC_READ, gen::INST_SYNC_WRITE,
                                 gen::INST_WRITE,   gen::INST_SYNC_WRITE, gen::INST_WRITE,   0x77};

// The rest of the input, as numbers; zeros when it is used up.
struct Input {
  const uint8_t* data;
  size_t size;
  uint8_t byte() {
    if (size == 0) return 0;
    --size;
    return *data++;
  }
  uint16_t word() {
    const uint8_t low = byte();
    return static_cast<uint16_t>(low | byte() << 8);
  }
  std::vector<uint8_t> bytes(size_t count) {
    count = std::min(count, size);
    std::vector<uint8_t> taken(data, data + count);
    data += count;
    size -= count;
    return taken;
  }
};

// Makes a whole servo packet with a valid checksum, whatever is in its fields.
inline std::vector<uint8_t> servo_packet(uint8_t id, uint8_t instruction, const std::vector<uint8_t>& parameters) {
  std::vector<uint8_t> p = {0xFF, 0xFF, id, static_cast<uint8_t>(parameters.size() + 2), instruction};
  p.insert(p.end(), parameters.begin(), parameters.end());
  p.push_back(servo_checksum(&p[2], static_cast<uint8_t>(p.size() - 2)));
  return p;
}

}  // namespace hexwire

#endif  // HEXWIRE_FUZZ_INPUT_H
