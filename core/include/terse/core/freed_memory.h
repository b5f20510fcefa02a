#pragma once

namespace terse {

// For a program that solves, and ends or has little beside it: called once at its start, `terse solve` takes half of
// the time on a virtual machine that is slow to give memory (docs/benchmarks.md). What is freed stays for what comes
// next, up to 256 MB, and the heap's first 192 MB are in the system's large pages where it has any. A library does not
// decide that for a program. With glibc, for memory of the thread that calls it; does nothing elsewhere.
void KeepFreedMemory();

}  // namespace terse
