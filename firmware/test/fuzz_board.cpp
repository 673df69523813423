// Fuzz target: an attacker sends valid frames, valid packets and noise to a board with seven servos that answer.
// In any mixture: the board reads and writes only its own memory, never hangs, and answers IDENTIFY afterwards;
// nothing moves or gains torque while it is stopped; nothing sent before a stop is executed after it; no target is
// beyond its limits or faster than its speed limit; no setting of a servo changes outside maintenance; in dialect 2
// only TORQUE gives a joint torque; and a frame for another module has no effect. fuzz_attack.cpp reads the input,
// fuzz_world.cpp checks what happens.
#include "bytes.h"
#include "fuzz_attack.h"

namespace {

using namespace hexwire;

bool answered(const std::vector<uint8_t>& out, uint8_t cmd, uint8_t seq) {
  for (size_t i = 0; i + kBodyAt <= out.size(); ++i) {
    if (get32(&out[i]) == gen::SYNC && out[i + 38] == cmd && out[i + 34] == seq) return true;
  }
  return false;
}

void judge_stopped(World& world, bool limp) {
  if (!(world.flags() & gen::BOARD_FLAG_STOPPED)) broken("not stopped");
  if (!world.clean()) return;
  for (const ServoModel& servo : world.line().servos) {
    if (servo.torque_on() && servo.mode() != 0) broken("torque in another mode after a stop", servo.id());
    if (servo.torque_on() && limp) broken("torque after a stop with torque off", servo.id());
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  Input input = {data, size};
  const uint8_t how = input.byte();
  const bool limp = how & 16;
  World world(how, input.byte());
  if (how & 8) world.run(300000);
  Attack(world, input).run();
  world.aim(gen::MODULE_ARM_7BOT_ARDUINO_TRX);
  // Let everything finish: waiting requests, time-outs, an unfinished frame, a half-written setting.
  world.run(600000);
  for (ServoModel& servo : world.line().servos) servo.silent = false;
  // With numbers of their own: a repeat of an earlier frame would not be executed.
  world.put_frame(gen::PROTO_HEXWIRE, gen::CMD_STOP, {limp}, world.next_seq());
  world.run(1500000);
  judge_stopped(world, limp);
  world.seen.clear();
  const uint8_t seq = world.next_seq();
  world.put_frame(gen::PROTO_HEXWIRE, gen::CMD_IDENTIFY, {}, seq);
  world.run(gen::DIALECT2_REPLY_WINDOW_MS * 1000u);
  if (!answered(world.seen, gen::CMD_IDENTIFY, seq)) broken("IDENTIFY is not answered");
  return 0;
}
