#pragma once
// Errors that the library throws. Misuse of a function is std::invalid_argument.

#include <stdexcept>
#include <string>

namespace terse {

// Bad input from a file: what() reads "path:line: cause" (line 0: the file as a whole, printed "path: cause").
class FileError : public std::runtime_error {
 public:
  FileError(const std::string& path, long line, const std::string& cause)
      : std::runtime_error(path + (line > 0 ? ":" + std::to_string(line) : "") + ": " + cause),
        path_(path),
        line_(line),
        cause_(cause) {}
  const std::string& path() const { return path_; }
  long line() const { return line_; }
  const std::string& cause() const { return cause_; }

 private:
  std::string path_;
  long line_;
  std::string cause_;
};

// The linear system is singular or not positive definite (gauge not fixed, a component without prior, overflow).
class NumericalError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace terse
