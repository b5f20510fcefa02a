# cmake -D input=FILE -D output=FILE.cpp -D header=H -D function=NAME -P EmbedText.cmake
#
# Writes a source file with terse::NAME(), which returns the text of `input`.
file(READ ${input} text)
file(WRITE ${output} "// From ${function}'s text file.
#include \"${header}\"

namespace terse {

std::string ${function}() {
  static constexpr char kText[] = R\"terse_text(${text})terse_text\";
  return std::string(kText, sizeof(kText) - 1);
}

}  // namespace terse
")
