#include "npz_file.h"

#include <cstring>
#include <limits>

#include "terse/core/atomic_file.h"
#include "terse/core/crc32.h"

namespace terse {
namespace {

constexpr bool kLittleEndian = __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__;

template <class Number>
std::string Bytes(const std::vector<Number>& numbers) {
  std::string out(numbers.size() * sizeof(Number), '\0');
  if (!numbers.empty()) std::memcpy(out.data(), numbers.data(), out.size());
  return out;
}

// Little-endian, as all of a zip file is.
void Put(std::string& out, std::size_t value, int bytes) {
  for (int k = 0; k < bytes; ++k) out += static_cast<char>((value >> (8 * k)) & 255u);
}

// Format 1.0: magic, version, length of the header, a Python literal padded so that the data begins at 64 bytes.
std::string Npy(const NpzArray& array) {
  std::string header =
      "{'descr': '" + std::string(kLittleEndian ? "<" : ">") + array.type + "', 'fortran_order': False, 'shape': (";
  for (const std::size_t n : array.shape) header += std::to_string(n) + ", ";
  header += "), }";
  constexpr std::size_t kPrefix = 10, kAlignment = 64;
  header.append((kAlignment - (kPrefix + header.size() + 1) % kAlignment) % kAlignment, ' ');
  header += '\n';
  std::string out("\x93NUMPY\x01\x00", 8);
  Put(out, header.size(), 2);
  return out + header + array.bytes;
}

// What the local header and the directory have in common: from the version needed to the length of the extra field.
std::string Entry(const std::string& name, const std::string& content) {
  constexpr std::size_t kFirstOfJanuary1980 = 33;
  std::string out;
  Put(out, 20, 2);  // version 2.0
  Put(out, 0, 2);   // flags
  Put(out, 0, 2);   // stored
  Put(out, 0, 2);   // time
  Put(out, kFirstOfJanuary1980, 2);
  Put(out, Crc32(content), 4);
  Put(out, content.size(), 4);
  Put(out, content.size(), 4);
  Put(out, name.size(), 2);
  Put(out, 0, 2);
  return out;
}

}  // namespace

NpzArray MakeNpzArray(const std::string& name, const std::vector<std::int64_t>& numbers) {
  return {name, "i8", {numbers.size()}, Bytes(numbers)};
}

NpzArray MakeNpzArray(const std::string& name, const std::vector<std::size_t>& shape,
                      const std::vector<double>& numbers) {
  return {name, "f8", shape, Bytes(numbers)};
}

void WriteNpz(const std::vector<NpzArray>& arrays, const std::string& path) {
  AtomicFile file(path);
  std::string directory;
  std::size_t offset = 0;
  for (const NpzArray& array : arrays) {
    const std::string name = array.name + ".npy", content = Npy(array);
    if (offset + content.size() > std::numeric_limits<std::uint32_t>::max()) {
      throw FileError(path, 0, "the arrays are more than the 4 GiB that a zip file can hold");
    }
    const std::string entry = Entry(name, content);
    std::string local = "PK\x03\x04";
    local.append(entry).append(name);
    file.Stream() << local << content;
    directory += "PK\x01\x02";
    Put(directory, 20, 2);  // made by version 2.0
    directory += entry;
    Put(directory, 0, 2);  // no comment
    Put(directory, 0, 2);  // disk
    Put(directory, 0, 2);  // attributes
    Put(directory, 0, 4);
    Put(directory, offset, 4);
    directory += name;
    offset += local.size() + content.size();
  }
  std::string end = "PK\x05\x06";
  Put(end, 0, 4);  // disks
  Put(end, arrays.size(), 2);
  Put(end, arrays.size(), 2);
  Put(end, directory.size(), 4);
  Put(end, offset, 4);
  Put(end, 0, 2);
  file.Stream() << directory << end;
  file.Commit();
}

}  // namespace terse
