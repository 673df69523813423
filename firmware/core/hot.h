// For files that determine the speed of the servo line: the Arduino IDE builds everything for size.
#ifndef HEXWIRE_HOT_H
#define HEXWIRE_HOT_H

#if defined(__AVR__)
#pragma GCC optimize("O2")
#endif

#endif  // HEXWIRE_HOT_H
