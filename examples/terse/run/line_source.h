#pragma once
// Standard input by lines, as a program feeds terse online.

#include <cstddef>
#include <deque>
#include <string>

namespace terse {

struct InputLine {
  std::string text;   // without blanks at its ends
  long number = 0;    // from 1
  bool torn = false;  // the input ends within it: it may hold half of a number
};

// Lines may be looked at before they are taken. Throws FileError if standard input cannot be read, or brings no line
// end within kMostLineBytes: what has no end is no lines.
class LineSource {
 public:
  static constexpr char kName[] = "stdin";

  // The dimension of the first measurement that has one, 0 if none comes. Lines that mean nothing before it (blank
  // ones, comments) are let go. Throws FileError if there are too many others.
  int FindDimension();
  // False at the end.
  bool Next(InputLine& line);

 private:
  bool Read(InputLine& line);
  bool Fill();

  std::deque<InputLine> ahead_;
  std::string buffer_;
  std::size_t taken_ = 0;  // of buffer_
  long number_ = 0;
};

inline constexpr char kBlanks[] = " \t\r\v\f";
std::string Trimmed(const std::string& text);

}  // namespace terse
