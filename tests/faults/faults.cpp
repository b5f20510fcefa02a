// A library to preload: makes one system call of a program fail, come back short, or be its last.
//
// TERSE_FAULT is ACTION:N, for the N-th call, from 1, among those that write (not to standard error), sync, rename,
// truncate or remove:
//   kill    killed by SIGKILL within it: half of a write is done, all else not
//   full    it fails with ENOSPC, and so does every write to a regular file after it
//   io      it fails with EIO
//   intr    it fails with EINTR, if it is a write or a sync
//   short   half of the write is done
// or, for the N-th call of read:
//   read-io, read-intr   it fails with EIO or EINTR
//   read-short           it brings one byte
// TERSE_FAULT_COUNT names a file that the number of these calls, and of those of read, is written to at the end.

#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>

namespace {

enum class Call { kWrite, kSync, kOther };

std::atomic<long> calls{0}, reads{0};
std::atomic<bool> full{false};

template <class Function>
Function Next(const char* name) {
  return reinterpret_cast<Function>(dlsym(RTLD_NEXT, name));
}

bool Asks(const char* action, long call) {
  const char* const fault = std::getenv("TERSE_FAULT");
  const std::size_t length = std::strlen(action);
  return fault != nullptr && std::strncmp(fault, action, length) == 0 && fault[length] == ':' &&
         std::atol(fault + length + 1) == call;
}

bool IsRegular(int descriptor) {
  struct stat status;
  return fstat(descriptor, &status) == 0 && S_ISREG(status.st_mode);
}

struct Fate {
  bool half = false, dies = false;
  int error = 0;
};

Fate FateOf(Call kind, int descriptor) {
  const long call = ++calls;
  Fate fate;
  fate.dies = Asks("kill", call);
  fate.half = kind == Call::kWrite && (fate.dies || Asks("short", call));
  if (Asks("full", call)) full = true;
  if (full && kind != Call::kOther && IsRegular(descriptor)) fate.error = ENOSPC;
  if (Asks("io", call)) fate.error = EIO;
  if (kind != Call::kOther && Asks("intr", call)) fate.error = EINTR;
  if (fate.dies && kind != Call::kWrite) raise(SIGKILL);
  return fate;
}

struct AtEnd {
  ~AtEnd() {
    const char* const path = std::getenv("TERSE_FAULT_COUNT");
    if (path == nullptr) return;
    const long count = calls, read_count = reads;
    const int descriptor = open(path, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    if (descriptor < 0) return;
    dprintf(descriptor, "%ld %ld\n", count, read_count);
    close(descriptor);
  }
} at_end;

int Fail(int error) {
  errno = error;
  return -1;
}

}  // namespace

extern "C" {

ssize_t write(int descriptor, const void* bytes, size_t size) {
  static const auto real = Next<ssize_t (*)(int, const void*, size_t)>("write");
  if (descriptor == STDERR_FILENO) return real(descriptor, bytes, size);
  const Fate fate = FateOf(Call::kWrite, descriptor);
  if (fate.error != 0) return Fail(fate.error);
  const ssize_t done = real(descriptor, bytes, fate.half && size > 1 ? size / 2 : size);
  if (fate.dies) raise(SIGKILL);
  return done;
}

// As the C++ streams do it; its parts are written one after the other.
ssize_t writev(int descriptor, const struct iovec* parts, int count) {
  ssize_t done = 0;
  for (int k = 0; k < count; ++k) {
    if (parts[k].iov_len == 0) continue;
    const ssize_t part = write(descriptor, parts[k].iov_base, parts[k].iov_len);
    if (part < 0) return done > 0 ? done : -1;
    done += part;
    if (part < static_cast<ssize_t>(parts[k].iov_len)) break;
  }
  return done;
}

ssize_t read(int descriptor, void* bytes, size_t size) {
  static const auto real = Next<ssize_t (*)(int, void*, size_t)>("read");
  const long call = ++reads;
  if (Asks("read-io", call)) return Fail(EIO);
  if (Asks("read-intr", call)) return Fail(EINTR);
  return real(descriptor, bytes, Asks("read-short", call) && size > 1 ? 1 : size);
}

int fsync(int descriptor) {
  static const auto real = Next<int (*)(int)>("fsync");
  const Fate fate = FateOf(Call::kSync, descriptor);
  return fate.error != 0 ? Fail(fate.error) : real(descriptor);
}

int fdatasync(int descriptor) {
  static const auto real = Next<int (*)(int)>("fdatasync");
  const Fate fate = FateOf(Call::kSync, descriptor);
  return fate.error != 0 ? Fail(fate.error) : real(descriptor);
}

int ftruncate(int descriptor, off_t size) {
  static const auto real = Next<int (*)(int, off_t)>("ftruncate");
  const Fate fate = FateOf(Call::kOther, descriptor);
  return fate.error != 0 ? Fail(fate.error) : real(descriptor, size);
}

int rename(const char* from, const char* to) {
  static const auto real = Next<int (*)(const char*, const char*)>("rename");
  const Fate fate = FateOf(Call::kOther, -1);
  return fate.error != 0 ? Fail(fate.error) : real(from, to);
}

int unlink(const char* path) {
  static const auto real = Next<int (*)(const char*)>("unlink");
  const Fate fate = FateOf(Call::kOther, -1);
  return fate.error != 0 ? Fail(fate.error) : real(path);
}

}  // extern "C"
