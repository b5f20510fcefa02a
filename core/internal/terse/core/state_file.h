#pragma once
// The state of a running object in a file: whole or not at all, checked, exact to the last bit.
//
// Layout, all numbers little-endian: the 8 bytes of kStateMagic; u32 kStateFormat; u32 length of the kind, the kind
// ("what is stored", a file of another kind is refused); u64 length of the members, the members; u64 FNV-1a hash of all
// before. Doubles are their 8 bytes; an integer has 4 bytes, or 8 if its type is long or longer; bool and char 1; an
// enum 4; a long double three doubles that add up to it; a container its count (u64) and its elements, maps by
// ascending key; an optional whether it is there, a variant which one it is. So a file does not depend on the machine.
// A resumed run repeats every bit on the same build and processor family only: the library chooses its kernels by the
// processor.
//
// To store a class, list its members once, for writing and reading:
//
//   class Robot {
//     ...
//     void Save(const std::string& path) const { SaveState(path, "robot", *this); }
//     static Robot Load(const std::string& path) { return LoadState<Robot>(path, "robot"); }
//    private:
//     friend struct internal::StateAccess;
//     template <class Archive> void Serialize(Archive& archive);
//   };
//
//   template <class Archive>
//   void Robot::Serialize(Archive& archive) {
//     auto& [name, solver, cache] = *this;  // does not compile any more when a member is added
//     archive(name, *solver);               // solver: std::unique_ptr<IncrementalSolver<SE3>>, there already
//     if constexpr (Archive::kReads) {
//       if (name.empty()) archive.Fail("a robot without a name");
//       cache.reset();                      // what is derived is made again
//     }
//   }
//   template void Robot::Serialize(StateWriter&);  // in the .cpp
//   template void Robot::Serialize(StateReader&);
//
// An aggregate has a free function Serialize(archive, value) in its namespace instead (state_members.h has those of
// this library, and what is needed to store an IncrementalSolver inside another class). Serialize changes nothing when
// it writes. Reading goes into a new object that is thrown away if anything is wrong. Whoever adds, removes or reorders
// members raises kStateFormat: another format is refused.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <unordered_map>
#include <utility>
#include <variant>
#include <vector>

#include "terse/core/error.h"
#include "terse/lie/types.h"

namespace terse {

inline constexpr char kStateMagic[9] = "TERSE\0\x1a\n";
inline constexpr std::uint32_t kStateFormat = 11;

namespace internal {

struct StateAccess {
  template <class Archive, class T>
  static auto Call(Archive& archive, T& value, int) -> decltype(value.Serialize(archive)) {
    value.Serialize(archive);
  }
  template <class Archive, class T>
  static auto Call(Archive& archive, T& value, long) -> decltype(Serialize(archive, value)) {
    Serialize(archive, value);
  }
};

// The type that a number has in the file.
template <class T>
using StoredInteger = std::conditional_t<
    std::is_same_v<T, bool>, std::uint8_t,
    std::conditional_t<std::is_same_v<T, long> || std::is_same_v<T, long long>, std::int64_t,
                       std::conditional_t<std::is_same_v<T, unsigned long> || std::is_same_v<T, unsigned long long>,
                                          std::uint64_t, T>>>;
template <class T>
using Stored = std::conditional_t<std::is_enum_v<T>, std::int32_t, StoredInteger<T>>;

// Arrays of these lie in memory as in the file.
template <class T>
inline constexpr bool kIsRaw =
    std::is_arithmetic_v<T> && !std::is_same_v<T, bool> && !std::is_same_v<T, long double> &&
    std::is_same_v<T, Stored<T>> && (sizeof(T) == 1 || __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__);

template <class T>
inline constexpr bool kIsNumber = std::is_arithmetic_v<T> || std::is_enum_v<T>;

}  // namespace internal

// Collects members, then writes the file.
class StateWriter {
 public:
  static constexpr bool kReads = false;
  explicit StateWriter(const std::string& kind);

  template <class... T>
  void operator()(const T&... values) {
    (Put(values), ...);
  }
  void Doubles(const double* values, std::size_t count) {
    for (std::size_t k = 0; !internal::kIsRaw<double> && k < count; ++k) Put(values[k]);
    if (internal::kIsRaw<double>) PutBytes(values, count * sizeof(double));
  }
  // The count, then visit(element) for each.
  template <class T, class Visit>
  void Each(const std::vector<T>& list, const Visit& visit) {
    Put(static_cast<std::uint64_t>(list.size()));
    for (const T& element : list) visit(const_cast<T&>(element));
  }
  // Throws FileError; the file is then as it was before.
  void Save(const std::string& path) &&;
  // What Save would write.
  std::string Bytes() &&;

 private:
  void PutBytes(const void* bytes, std::size_t count) { bytes_.append(static_cast<const char*>(bytes), count); }
  void PutLongDouble(long double number);

  template <class T, std::enable_if_t<internal::kIsNumber<T>, int> = 0>
  void Put(T number) {
    if constexpr (std::is_same_v<T, long double>) {
      PutLongDouble(number);
    } else {
      static_assert(!std::is_enum_v<T> || sizeof(T) <= 4, "an enum is stored in four bytes");
      const auto stored = static_cast<internal::Stored<T>>(number);
      char bytes[sizeof(stored)];
      std::memcpy(bytes, &stored, sizeof(stored));
      if (__BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__) std::reverse(bytes, bytes + sizeof(stored));
      PutBytes(bytes, sizeof(stored));
    }
  }
  template <class T, std::enable_if_t<!internal::kIsNumber<T>, int> = 0>
  void Put(const T& value) {
    internal::StateAccess::Call(*this, const_cast<T&>(value), 0);  // which changes nothing when it writes
  }
  template <int Rows, int Columns, int Options>
  void Put(const Eigen::Matrix<double, Rows, Columns, Options>& matrix) {
    static_assert(Rows > 0 && Columns > 0, "of fixed size");
    Doubles(matrix.data(), static_cast<std::size_t>(Rows * Columns));
  }
  template <class T>
  void Put(const std::vector<T>& list) {
    if constexpr (internal::kIsRaw<T>) {
      Put(static_cast<std::uint64_t>(list.size()));
      PutBytes(list.data(), list.size() * sizeof(T));
    } else {
      Put(static_cast<std::uint64_t>(list.size()));
      for (const T& element : list) Put(element);
    }
  }
  void Put(const std::string& text) {
    Put(static_cast<std::uint64_t>(text.size()));
    PutBytes(text.data(), text.size());
  }
  template <class A, class B>
  void Put(const std::pair<A, B>& pair) {
    Put(pair.first);
    Put(pair.second);
  }
  template <class T>
  void Put(const std::optional<T>& value) {
    Put(value.has_value());
    if (value) Put(*value);
  }
  template <class... T>
  void Put(const std::variant<T...>& value) {
    Put(static_cast<std::uint32_t>(value.index()));
    std::visit([this](const auto& held) { this->Put(held); }, value);
  }
  template <class Key, class T>
  void Put(const std::map<Key, T>& map) {
    Put(static_cast<std::uint64_t>(map.size()));
    for (const auto& entry : map) Put(entry);
  }
  template <class Key, class T>
  void Put(const std::unordered_map<Key, T>& map) {
    std::map<Key, const T*> sorted;
    for (const auto& [key, value] : map) sorted.emplace(key, &value);
    Put(static_cast<std::uint64_t>(map.size()));
    for (const auto& [key, value] : sorted) {
      Put(key);
      Put(*value);
    }
  }

  std::string bytes_;  // of the file so far
  std::size_t members_at_;
};

// Gives members out again. The constructor throws FileError if the file cannot be read, is none of these, of another
// format or kind, too short, too long or damaged; the rest where the members make no sense.
class StateReader {
 public:
  static constexpr bool kReads = true;
  StateReader(const std::string& path, const std::string& kind);
  // Of bytes at hand; `name` stands for the path in messages.
  StateReader(std::string bytes, const std::string& name, const std::string& kind);

  template <class... T>
  void operator()(T&... values) {
    (Get(values), ...);
  }
  void Doubles(double* values, std::size_t count) {
    Require(count, sizeof(double));
    for (std::size_t k = 0; !internal::kIsRaw<double> && k < count; ++k) Get(values[k]);
    if (internal::kIsRaw<double>) GetBytes(values, count * sizeof(double));
  }
  template <class T, class Visit>
  void Each(std::vector<T>& list, const Visit& visit) {
    list.clear();
    // Not reserved: memory grows with what was found in the file, whatever the count claims.
    for (std::uint64_t left = Count(1); left > 0; --left) visit(list.emplace_back());
  }
  // Before memory is taken for so many.
  void Require(std::uint64_t count, std::size_t bytes_each) const {
    if (count > (members_end_ - at_) / bytes_each) Fail("it promises more than it holds");
  }
  // Throws FileError.
  [[noreturn]] void Fail(const std::string& cause) const;
  // Throws FileError if something is left.
  void Finish() const;

 private:
  void GetBytes(void* bytes, std::size_t count) {
    Require(count, 1);
    if (count == 0) return;
    std::memcpy(bytes, bytes_.data() + at_, count);
    at_ += count;
  }
  std::uint64_t Count(std::size_t bytes_each) {
    std::uint64_t count = 0;
    Get(count);
    Require(count, bytes_each);
    return count;
  }
  void GetLongDouble(long double& number);

  template <class T, std::enable_if_t<internal::kIsNumber<T>, int> = 0>
  void Get(T& number) {
    if constexpr (std::is_same_v<T, long double>) {
      GetLongDouble(number);
    } else {
      internal::Stored<T> stored;
      char bytes[sizeof(stored)];
      GetBytes(bytes, sizeof(stored));
      if (__BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__) std::reverse(bytes, bytes + sizeof(stored));
      std::memcpy(&stored, bytes, sizeof(stored));
      number = static_cast<T>(stored);
      if constexpr (!std::is_floating_point_v<T>) {
        if (static_cast<internal::Stored<T>>(number) != stored) Fail("a number is out of range");
      }
    }
  }
  template <class T, std::enable_if_t<!internal::kIsNumber<T>, int> = 0>
  void Get(T& value) {
    internal::StateAccess::Call(*this, value, 0);
  }
  template <int Rows, int Columns, int Options>
  void Get(Eigen::Matrix<double, Rows, Columns, Options>& matrix) {
    static_assert(Rows > 0 && Columns > 0, "of fixed size");
    Doubles(matrix.data(), static_cast<std::size_t>(Rows * Columns));
  }
  template <class T>
  void Get(std::vector<T>& list) {
    if constexpr (internal::kIsRaw<T>) {
      list.resize(Count(sizeof(T)));
      GetBytes(list.data(), list.size() * sizeof(T));
    } else {
      list.clear();
      for (std::uint64_t left = Count(1); left > 0; --left) {
        T element{};
        Get(element);
        list.push_back(std::move(element));
      }
    }
  }
  void Get(std::string& text) {
    text.resize(Count(1));
    GetBytes(text.data(), text.size());
  }
  template <class A, class B>
  void Get(std::pair<A, B>& pair) {
    Get(pair.first);
    Get(pair.second);
  }
  template <class T>
  void Get(std::optional<T>& value) {
    bool is_there = false;
    Get(is_there);
    value.reset();
    if (is_there) Get(value.emplace());
  }
  template <class... T>
  void Get(std::variant<T...>& value) {
    std::uint32_t index = 0;
    Get(index);
    if (index >= sizeof...(T)) Fail("a kind of value that there is not");
    GetAlternative(value, index, std::index_sequence_for<T...>());
  }
  template <class Variant, std::size_t... I>
  void GetAlternative(Variant& value, std::size_t index, std::index_sequence<I...>) {
    ((index == I ? Get(value.template emplace<I>()) : void()), ...);
  }
  template <class Key, class T>
  void Get(std::map<Key, T>& map) {
    GetMap(map);
  }
  template <class Key, class T>
  void Get(std::unordered_map<Key, T>& map) {
    GetMap(map);
  }
  template <class Map>
  void GetMap(Map& map) {
    map.clear();
    for (std::uint64_t left = Count(1); left > 0; --left) {
      typename Map::key_type key{};
      Get(key);
      const auto [entry, is_new] = map.try_emplace(key);
      if (!is_new) Fail("a key comes twice");
      Get(entry->second);
    }
  }

  void Open(const std::string& kind);

  std::string path_, bytes_;
  std::size_t at_ = 0, members_end_ = 0;
};

// Throws FileError; the file is then as it was before.
template <class T>
void SaveState(const std::string& path, const std::string& kind, const T& object) {
  StateWriter writer(kind);
  writer(object);
  std::move(writer).Save(path);
}

namespace internal {

template <class T>
T ReadObject(StateReader reader) {
  T object;
  try {
    reader(object);
  } catch (const std::logic_error& error) {  // what the class itself refuses
    reader.Fail(error.what());
  }
  reader.Finish();
  return object;
}

}  // namespace internal

// Throws FileError.
template <class T>
T LoadState(const std::string& path, const std::string& kind) {
  return internal::ReadObject<T>(StateReader(path, kind));
}

// The same in memory instead of in a file.
template <class T>
std::string StateBytes(const std::string& kind, const T& object) {
  StateWriter writer(kind);
  writer(object);
  return std::move(writer).Bytes();
}
template <class T>
T FromStateBytes(std::string bytes, const std::string& name, const std::string& kind) {
  return internal::ReadObject<T>(StateReader(std::move(bytes), name, kind));
}

// The kind of an object over SE2 or SE3.
template <class Pose>
std::string StateKind(const std::string& what) {
  return what + (Pose::kDim == 2 ? " SE2" : " SE3");
}

}  // namespace terse
