// What is easier to test from the inside: the decoder with any split, the master of the servo line with any noise,
// the bounded stores. Built with the address and undefined-behaviour sanitizers.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <random>

#include "../boards/host/host_board.h"
#include "boot_counter.h"
#include "bytes.h"

namespace {

using namespace hexwire;

int failures = 0;

#define CHECK(condition)                                              \
  do {                                                                \
    if (!(condition)) {                                               \
      printf("%s:%d: %s\n", __FILE__, __LINE__, #condition);          \
      ++failures;                                                     \
    }                                                                 \
  } while (0)

std::vector<uint8_t> frame(uint8_t cmd, const std::vector<uint8_t>& body, uint8_t seq, uint8_t proto) {
  uint8_t bytes[gen::MAX_SERIAL_FRAME];
  std::copy(body.begin(), body.end(), bytes + kBodyAt);
  const FrameHead head = {1,     2,   seq, gen::MODULE_ARM_7BOT_SERIAL_TRX, gen::MODULE_ARM_7BOT_ARDUINO_TRX,
                          proto, seq, cmd, 0};
  const uint8_t size = finish_frame(bytes, head, static_cast<uint8_t>(body.size()));
  return std::vector<uint8_t>(bytes, bytes + size);
}

void feed(FrameDecoder& decoder, const std::vector<uint8_t>& bytes, size_t begin, size_t end, uint32_t now,
          std::vector<uint8_t>* seqs) {
  Frame found;
  while (begin < end) {
    const size_t count = std::min<size_t>(decoder.room(), end - begin);
    memcpy(decoder.space(), &bytes[begin], count);
    decoder.added(static_cast<uint8_t>(count), now);
    begin += count;
    while (decoder.next(found)) seqs->push_back(found.seq);
  }
}

// Checksums from the chapter's log, and the CRC of the test string of the CRC catalogue.
void checks() {
  const uint8_t digits[] = {'1', '2', '3', '4', '5', '6', '7', '8', '9'};
  CHECK(crc16(digits, sizeof(digits)) == 0x29B1);
  const uint8_t read[] = {0x06, 0x04, 0x02, 0x3C, 0x02};
  CHECK(servo_checksum(read, sizeof(read)) == 0xB5);
  CHECK(decode_signed(0x8064, 0x8000) == -100);
  CHECK(encode_signed(-100, 0x8000) == 0x8064);
  CHECK(decode_signed(0x0405, 0x0400) == -5);
}

void any_split() {
  std::vector<uint8_t> stream;
  for (uint8_t seq = 0; seq < 3; ++seq) {
    const std::vector<uint8_t> f = frame(gen::CMD_STATS, std::vector<uint8_t>(seq * 7u, 0x0D), seq, gen::PROTO_HEXWIRE);
    stream.insert(stream.end(), f.begin(), f.end());
  }
  for (size_t cut = 0; cut <= stream.size(); ++cut) {
    Stats stats = Stats();
    FrameDecoder decoder(stats);
    std::vector<uint8_t> seqs;
    feed(decoder, stream, 0, cut, 0, &seqs);
    feed(decoder, stream, cut, stream.size(), 0, &seqs);
    CHECK((seqs == std::vector<uint8_t>{0, 1, 2}));
    CHECK(stats.bytes_dropped == 0);
  }
}

// Valid frames between noise are all found, even if the noise looks like the start of a frame.
void noise_between() {
  std::mt19937 dice(7);
  for (int round = 0; round < 300; ++round) {
    Stats stats = Stats();
    FrameDecoder decoder(stats);
    std::vector<uint8_t> stream, seqs;
    for (uint8_t seq = 0; seq < 4; ++seq) {
      for (unsigned i = static_cast<unsigned>(dice() % 40); i; --i) stream.push_back(static_cast<uint8_t>(dice() % 3 ? dice() : 0x5A));
      const std::vector<uint8_t> f = frame(gen::CMD_PING, std::vector<uint8_t>(dice() % 30, 0x5A), seq, 1 + (seq & 1));
      stream.insert(stream.end(), f.begin(), f.end());
    }
    feed(decoder, stream, 0, stream.size(), 0, &seqs);
    Frame found;
    while (decoder.expire(100000)) {
      while (decoder.next(found)) seqs.push_back(found.seq);
    }
    CHECK((seqs == std::vector<uint8_t>{0, 1, 2, 3}));
    CHECK(!decoder.receiving());
  }
}

// No bytes on the servo line, in whatever pieces, make the board act, hang or read outside its own memory.
void noise_on_the_bus() {
  std::mt19937 dice(11);
  HostBoard b;
  b.board.begin(1, 0);
  for (int i = 0; i < 20000; ++i) {
    b.now_us += 100;
    if (dice() % 4 == 0) {
      for (unsigned n = static_cast<unsigned>(dice() % 6); n; --n) b.from_bus.push_back(static_cast<uint8_t>(dice() % 4 ? dice() : 0xFF));
    }
    b.board.poll();
    b.to_bus.clear();
  }
  const std::vector<uint8_t> ask = frame(gen::CMD_IDENTIFY, std::vector<uint8_t>(), 9, gen::PROTO_HEXWIRE);
  b.from_host = ask;
  for (int i = 0; i < 1000; ++i) {
    b.now_us += 100;
    b.board.poll();
  }
  CHECK(b.to_host.size() >= gen::FRAME_OVERHEAD && b.to_host[34] == 9 && b.to_host[38] == gen::CMD_IDENTIFY);
}

void queue_is_bounded() {
  RequestQueue queue;
  uint8_t body[50] = {0};
  Frame f = {7, 8, gen::PROTO_HEXWIRE, 0, gen::CMD_TRANSACT, 0, sizeof(body), body};
  int taken = 0;
  while (queue.push(f)) ++taken;
  CHECK(taken == 8);
  f.size = 0;
  while (queue.count()) queue.pop();
  while (queue.push(f)) ++taken;
  CHECK(taken == 8 + 24);
  CHECK(queue.holds(f));
  Request first;
  while (queue.count()) queue.pop();
  CHECK(!queue.front(&first));
}

void stops_wait_together_and_are_answered_by_one() {
  StopList stops;
  for (uint8_t i = 0; i < 16; ++i) CHECK(stops.add(7, i, i & 1));
  CHECK(!stops.add(7, 16, 0));
  CHECK(stops.holds(7, 3, 1) && !stops.holds(7, 3, 0) && !stops.holds(6, 3, 1));
  stops.want(0);
  stops.want(1);
  StopList::Asker asker;
  StopList::Outcome outcome;
  CHECK(!stops.take_done(&asker, &outcome));
  stops.done(1, gen::STATUS_SERVO_SILENT, 0x3F);
  CHECK(stops.wanted(0) && !stops.wanted(1));
  for (uint8_t i = 1; i < 16; i = static_cast<uint8_t>(i + 2)) {
    CHECK(stops.take_done(&asker, &outcome) && asker.seq == i && asker.mode == 1);
    CHECK(outcome.status == gen::STATUS_SERVO_SILENT && outcome.mask == 0x3F);
  }
  CHECK(!stops.take_done(&asker, &outcome) && !stops.empty());
  stops.done(0, gen::STATUS_OK, 0x7F);
  for (uint8_t i = 0; i < 16; i = static_cast<uint8_t>(i + 2)) CHECK(stops.take_done(&asker, &outcome) && asker.seq == i);
  CHECK(stops.empty());
}

void what_was_void_is_known_for_two_seconds() {
  VoidedStore store;
  const uint8_t body[2] = {1, 2};
  const uint8_t other[2] = {1, 3};
  Frame f = {7, 8, gen::PROTO_HEXWIRE, 5, gen::CMD_IO, 0, 2, body};
  store.add(Request{7, gen::PROTO_HEXWIRE, 5, gen::CMD_IO, 2, body}, 1000);
  CHECK(store.holds(f, 1000 + gen::REPEAT_WINDOW_MS));
  CHECK(!store.holds(f, 1001 + gen::REPEAT_WINDOW_MS));
  f.body = other;
  CHECK(!store.holds(f, 1000));
  f.body = body;
  f.src = 7 + 256;
  CHECK(!store.holds(f, 1000));
  f.src = 7;
  store.forget(8);
  CHECK(store.holds(f, 1000));
  // Its times have 16 bits: old entries are dropped before the times wrap.
  for (int i = 0; i < 32; ++i) store.age(4000);
  CHECK(!store.holds(f, 1000 + 65536));
  store.add(Request{7, gen::PROTO_HEXWIRE, 5, gen::CMD_IO, 2, body}, 70000);
  CHECK(store.holds(f, 70001));
  store.forget(7);
  CHECK(!store.holds(f, 70001));
  // It holds the last 32.
  for (uint8_t i = 0; i < 33; ++i) store.add(Request{7, gen::PROTO_HEXWIRE, i, gen::CMD_IO, 2, body}, 70000);
  f.seq = 0;
  CHECK(!store.holds(f, 70001));
  f.seq = 1;
  CHECK(store.holds(f, 70001));
}

void a_repeat_is_known_by_its_body_and_its_age() {
  ReplyStore store;
  const uint8_t body[2] = {1, 2};
  const uint8_t other[2] = {1, 3};
  const Request request = {7, gen::PROTO_HEXWIRE, 5, gen::CMD_IO, 2, body};
  store.add(request, gen::STATUS_OK, body, 2, 1000);
  Frame f = {7, 8, gen::PROTO_HEXWIRE, 5, gen::CMD_IO, 0, 2, body};
  CHECK(store.find(f, 1000 + gen::REPEAT_WINDOW_MS) != nullptr);
  CHECK(store.find(f, 1001 + gen::REPEAT_WINDOW_MS) == nullptr);
  f.body = other;
  CHECK(store.find(f, 1000) == nullptr);
  f.body = body;
  for (uint8_t i = 0; i < gen::STORED_REPLIES; ++i) {
    const Request newer = {7, gen::PROTO_HEXWIRE, static_cast<uint8_t>(6 + i), gen::CMD_IO, 2, body};
    store.add(newer, gen::STATUS_OK, body, 2, 1000);
  }
  CHECK(store.find(f, 1000) == nullptr);
}

void storage_that_does_not_keep_what_is_written() {
  HostBoard b;
  b.board.begin(1, 0);
  b.storage_broken = true;
  std::vector<uint8_t> rows(1, kJoints);
  for (uint8_t i = 0; i < kJoints; ++i) {
    const uint8_t row[] = {100, 0, 200, 0, 100, 0};
    rows.insert(rows.end(), row, row + sizeof(row));
  }
  b.from_host = frame(gen::CMD_LIMITS, rows, 3, gen::PROTO_HEXWIRE);
  for (int i = 0; i < 10000; ++i) {
    b.now_us += 100;
    b.board.poll();
  }
  CHECK(b.to_host.size() == gen::FRAME_OVERHEAD);
  CHECK(b.to_host[39] == (gen::EXT_REPLY | gen::STATUS_STORAGE));
}

// Resets without end wear all places evenly, and no id comes twice, wherever the power fails while one is stored.
void boot_ids_are_new() {
  std::mt19937 dice(3);
  HostBoard b;
  uint32_t last = 0;
  for (uint32_t resets = 1; resets <= 20000; ++resets) {
    const std::vector<uint8_t> before = b.storage;
    const uint32_t id = next_boot_id(b);
    CHECK(id > last);
    if (dice() % 4) {
      last = id;
      continue;
    }
    // The power failed: only the first bytes were written, and the program was never told of this id.
    unsigned whole = static_cast<unsigned>(dice() % 4);
    for (size_t i = 0; i < before.size(); ++i) {
      if (b.storage[i] != before[i] && whole-- == 0) {
        std::copy(before.begin() + static_cast<long>(i), before.end(), b.storage.begin() + static_cast<long>(i));
        break;
      }
    }
  }
  uint32_t most = 0;
  for (const uint32_t writes : b.storage_writes) most = std::max(most, writes);
  CHECK(most < 20000 / 64 + 20000 / 64 / 2);
}

void a_boot_id_goes_on_where_earlier_firmware_counted() {
  HostBoard b;
  CHECK(next_boot_id(b) == 1);
  put32(&b.storage[0], 1000);
  CHECK(next_boot_id(b) == 1001);
  // Damage does not stop it.
  put32(&b.storage[0], 0xFFFFFFFE);
  put32(&b.storage[1024 + 4 * 7], 50000);
  CHECK(next_boot_id(b) == 1002);
}

// The microsecond clock wraps after 71.6 minutes; the board's time does not.
void the_clock_wraps() {
  HostBoard b;
  b.now_us = 0xFFFFFF00u;
  b.board.begin(1, 0);
  for (int i = 0; i < 30000; ++i) {
    b.now_us += 100;
    b.board.poll();
  }
  b.from_host = frame(gen::CMD_STATS, std::vector<uint8_t>(), 3, gen::PROTO_HEXWIRE);
  for (int i = 0; i < 100; ++i) {
    b.now_us += 100;
    b.board.poll();
  }
  CHECK(b.to_host.size() > gen::FRAME_OVERHEAD);
  CHECK(get32(&b.to_host[4]) == 3);
  CHECK(get32(&b.to_host[kBodyAt]) >= 3000 && get32(&b.to_host[kBodyAt]) < 3020);
}

}  // namespace

int main() {
  checks();
  any_split();
  noise_between();
  noise_on_the_bus();
  queue_is_bounded();
  stops_wait_together_and_are_answered_by_one();
  what_was_void_is_known_for_two_seconds();
  a_repeat_is_known_by_its_body_and_its_age();
  storage_that_does_not_keep_what_is_written();
  boot_ids_are_new();
  a_boot_id_goes_on_where_earlier_firmware_counted();
  the_clock_wraps();
  printf("%d failures\n", failures);
  return failures != 0;
}
