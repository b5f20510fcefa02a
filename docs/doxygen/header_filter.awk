# Makes documentation comments for Doxygen out of the plain ones of a public header.
#
# - The comment behind #pragma once becomes the file's, and that of its first class without one.
# - A block of comment lines becomes that of the declaration in the next line.
# - A comment behind a declaration becomes its documentation.
# What comes out has as many lines as what goes in, so that links to the source lead to the right line.

function Escape(text) {
  gsub(/\\/, "\\\\", text); gsub(/@/, "\\@", text); gsub(/#/, "\\#", text); gsub(/%/, "\\%", text)
  gsub(/&/, "\\&amp;", text); gsub(/</, "\\&lt;", text); gsub(/>/, "\\&gt;", text)
  # A dot behind these does not end the first sentence.
  gsub(/Eq\. /, "Eq.\\ ", text); gsub(/Eqs\. /, "Eqs.\\ ", text)
  text = LinkPages(text)
  gsub(/et al\. /, "et al.\\ ", text); gsub(/e\.g\. /, "e.g.\\ ", text)
  return text
}

function LinkPages(text,    page) {
  if (match(text, /docs\/[a-z_]+\.md/)) {
    page = substr(text, RSTART + 5, RLENGTH - 8)
    text = substr(text, 1, RSTART - 1) "\\ref " page " \"docs/" page ".md\"" substr(text, RSTART + RLENGTH)
  }
  return text
}

function Text(line) {
  sub(/^[ \t]*\/\/ ?/, "", line)
  return line
}

function Indentation(line) {
  match(line, /^[ \t]*/)
  return substr(line, 1, RLENGTH)
}

# Prints lines `first` to `last`, all comment, with "///" for "//". Indented ones behind a colon, a comma before an
# equation or an empty line are formulas or code, and stay as they are.
function PrintBlock(first, last, indentation,    k, text, before, next_text, verbatim, listed) {
  for (k = first; k <= last; ++k) {
    text = Text(line[k])
    next_text = k < last ? Text(line[k + 1]) : ""
    if (text ~ /^ ?([0-9]+\.|-) /) listed = 1
    else if (text ~ /^[^ ]/ || text == "") listed = 0
    if (verbatim) {
      before = text
      if (next_text !~ /^  /) {
        before = before " \\endverbatim"
        verbatim = 0
      }
    } else {
      before = Escape(text)
      if (!listed && text !~ /^  / && next_text ~ /^  / && (text == "" || text ~ /:$/ || (text ~ /,$/ && next_text ~ / = /))) {
        before = before " \\verbatim"
        verbatim = 1
      }
    }
    print indentation "/// " before
  }
}

function IsComment(line) { return line ~ /^[ \t]*\/\// }
function IsDeclaration(line) {
  return line !~ /^[ \t]*$/ && line !~ /^[ \t]*[})#]/ && line !~ /^[ \t]*(public|protected|private):/ && !IsComment(line)
}

{ line[NR] = $0 }

# Of a file without classes the structs.
function IsClass(line) { return line ~ ("^" kind " [A-Za-z]+( final)?( :.*)? \\{") }

END {
  kind = "class"
  for (i = 1; i <= NR && !IsClass(line[i]); ++i) continue
  if (i > NR) kind = "struct"
  i = 1
  while (i <= NR && line[i] !~ /^#pragma once/) print line[i++]
  if (IsComment(line[i + 1])) {
    print "/// \\file"
    first = ++i
    while (IsComment(line[i + 1])) ++i
    PrintBlock(first, i++, "")
    name = FILENAME
    sub(/^.*\/include\//, "", name)
    copy = "/** \\copydoc " name " */ "
  }
  for (; i <= NR; ++i) {
    if (copy != "" && (IsClass(line[i]) || (line[i] ~ /^template </ && IsClass(line[i + 1])))) {
      if (!documented) {
        printf "%s", copy
        copy = ""
      }
    }
    if (IsComment(line[i])) {
      first = i
      while (IsComment(line[i + 1])) ++i
      documented = IsDeclaration(line[i + 1])
      if (documented && line[first] !~ /NOLINT/) PrintBlock(first, i, Indentation(line[first]))
      else for (k = first; k <= i; ++k) print line[k] ~ /NOLINT/ ? "" : line[k]
      continue
    }
    documented = 0
    at = match(line[i], /[;,a-zA-Z0-9_)] *\/\/ /)
    if (at > 0 && line[i] !~ /NOLINT/ && line[i] !~ /^ *(\}|#)/ && line[i] !~ /"[^"]*\/\//) {
      code = substr(line[i], 1, at)
      text = substr(line[i], at + 1)
      sub(/^ *\/\/ */, "", text)
      print code "  ///< " Escape(text)
    } else {
      print line[i]
    }
  }
}
