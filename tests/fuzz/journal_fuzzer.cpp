// Journals of online runs. An input that begins with '!' is damage to a journal that was written: its lines, a line
// "===", and changes of four bytes each (what, where as u16, how). Any other is the file itself. What is read of a
// damaged journal are the first of the lines that were written, in order.

#include <algorithm>
#include <filesystem>
#include <optional>
#include <vector>

#include "fuzzing.h"
#include "run/journal.h"

namespace terse::fuzz {
namespace {

std::vector<std::string> Lines(std::string_view text) {
  std::vector<std::string> out;
  while (!text.empty()) {
    out.emplace_back(text.substr(0, text.find('\n')));
    text.remove_prefix(std::min(text.size(), out.back().size() + 1));
  }
  return out;
}

std::string Written(const std::vector<std::string>& lines, const std::string& path) {
  std::filesystem::remove(path);
  Journal journal(path);
  journal.Create("{\"dimension\":2}");
  for (const std::string& line : lines) journal.Append(line);
  return path;
}

std::vector<std::string> ReadLines(Journal& journal) {
  std::vector<std::string> out;
  while (std::optional<std::string> line = journal.ReadLine()) out.push_back(std::move(*line));
  return out;
}

std::string Changed(std::string bytes, std::string_view changes) {
  constexpr std::size_t kChange = 4;
  for (; changes.size() >= kChange && !bytes.empty(); changes.remove_prefix(kChange)) {
    const auto byte = [&](std::size_t k) { return static_cast<std::size_t>(static_cast<unsigned char>(changes[k])); };
    const std::size_t at = (byte(1) | byte(2) << 8) % bytes.size(), count = std::min(byte(3), bytes.size() - at);
    switch (byte(0) % 5) {
      case 0: bytes[at] = changes[3]; break;
      case 1: bytes.erase(at, count); break;
      case 2: bytes.insert(at, bytes.substr(at, count)); break;
      case 3: bytes.resize(at); break;
      default:
        std::rotate(bytes.begin() + static_cast<long>(at), bytes.begin() + static_cast<long>(at + count), bytes.end());
    }
  }
  return bytes;
}

void ReadDamaged(std::string_view input, const ScratchFolder& folder) {
  constexpr std::string_view kEnd = "\n===\n";
  const std::size_t end = std::min(input.find(kEnd), input.size());
  const std::vector<std::string> lines = Lines(input.substr(0, end));
  const std::string path = Written(lines, folder.Path("journal"));
  const std::string bytes = Content(path);
  {
    Journal journal(path);
    Expect(ReadLines(journal) == lines, "all lines are read");
    Expect(journal.CutTail() == 0, "nothing is cut of a whole journal");
  }
  folder.With("journal", Changed(bytes, input.substr(std::min(end + kEnd.size(), input.size()))));
  Done([&] {
    Journal journal(path);
    if (journal.IsNew()) return;
    const std::vector<std::string> read = ReadLines(journal);
    Expect(read.size() <= lines.size() && std::equal(read.begin(), read.end(), lines.begin()),
           "the first of the lines that were written");
    journal.CutTail();
    journal.Append("VERTEX_SE2 1 0 0 0");
    journal.Sync();
  });
}

}  // namespace
}  // namespace terse::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace terse::fuzz;
  static ScratchFolder folder;
  const std::string_view input = AsText(data, size);
  if (!input.empty() && input[0] == '!') {
    ReadDamaged(input.substr(1), folder);
    return 0;
  }
  const std::string path = folder.With("journal", input);
  Done([&] {
    terse::Journal journal(path);
    if (!journal.IsNew()) terse::fuzz::ReadLines(journal);
  });
  return 0;
}
