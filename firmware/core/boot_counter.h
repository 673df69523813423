// The boot id, new at every start. Each is stored in the next of many places, so that a board which resets all the time
// does not wear out one of them. Must not know what the id is for.
#ifndef HEXWIRE_BOOT_COUNTER_H
#define HEXWIRE_BOOT_COUNTER_H

#include <stdint.h>

#include "platform.h"

namespace hexwire {

// The next boot id, which is stored. For the start of a board only: unlike everything else it waits for the storage.
uint32_t next_boot_id(Platform& platform);

}  // namespace hexwire

#endif  // HEXWIRE_BOOT_COUNTER_H
