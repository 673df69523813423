// Servos for the fuzz target: they answer like real ones and obey every packet, however dangerous.
// The model is far simpler than the emulator's: a joint turns at the speed it is given and stops at once.
// Owns registers and shafts. Checks nothing: a watcher is called for every write.
#ifndef HEXWIRE_SERVO_MODEL_H
#define HEXWIRE_SERVO_MODEL_H

#include <stdint.h>

#include <vector>

#include "generated.h"

namespace hexwire {

class ServoModel {
 public:
  ServoModel(uint8_t id, bool legacy, int16_t position);

  uint8_t id() const { return registers[gen::HLS_REG_ID]; }
  bool torque_on() const { return registers[gen::HLS_REG_TORQUE_ENABLE] == 1; }
  uint8_t mode() const { return legacy ? 0 : registers[gen::HLS_REG_MODE]; }
  uint16_t word(uint8_t address) const;
  void put_word(uint8_t address, uint16_t value);
  int16_t goal() const;

  void step(uint32_t us);
  // Makes the answer to a read of these registers; false if there is none.
  bool read(uint8_t address, uint8_t count, std::vector<uint8_t>* status);
  void write(uint8_t address, const uint8_t* data, uint8_t count);
  std::vector<uint8_t> status(const std::vector<uint8_t>& parameters) const;
  bool is_addressed(uint8_t to) const;

  const bool legacy;
  bool silent;
  double position;
  double speed;  // counts/s of the move under way
  uint8_t registers[256];
  std::vector<uint8_t> waiting;  // a REG_WRITE
};

// Is called for every servo that a packet changes, with its state before and after.
class ServoWatcher {
 public:
  virtual void written(const ServoModel& before, const ServoModel& after, bool goal) = 0;

 protected:
  ~ServoWatcher() {}
};

// Several servos on one line: packets in, answers out.
class ServoLine {
 public:
  ServoLine(ServoWatcher& watcher, const std::vector<ServoModel>& servos);

  // Takes a packet of the board when its last byte is sent; returns the bytes that come back.
  std::vector<uint8_t> exchange(const std::vector<uint8_t>& packet);
  void step(uint32_t us);

  std::vector<ServoModel> servos;

 private:
  struct Packet {
    uint8_t id;
    uint8_t instruction;
    const uint8_t* parameters;
    uint8_t count;
  };

  std::vector<uint8_t> obey(ServoModel& servo, const Packet& packet);
  void take(ServoModel& servo, const Packet& packet);
  void sync_write(ServoModel& servo, const Packet& packet);
  void reset(ServoModel& servo, uint8_t instruction);
  std::vector<uint8_t> sync_read(const Packet& packet);
  void write(ServoModel& servo, uint8_t address, const uint8_t* data, uint8_t count);

  ServoWatcher& watcher_;
};

}  // namespace hexwire

#endif  // HEXWIRE_SERVO_MODEL_H
