# Makes of a Markdown page, as it is for reading in the repository, one for Doxygen:
# $...$ and $$...$$ become formulas that KaTeX renders, headings get labels, links between pages follow these.
#
# Needs -v root=PATH, the project's folder. Labels: docs/howto/outliers.md is howto_outliers, its heading "In short"
# howto_outliers_in-short, after GitHub's rule for anchors.

function Label(path) {
  sub(/^docs\//, "", path); sub(/\.md$/, "", path)
  if (path == "README") return "index"
  sub(/\/README$/, "", path)
  gsub(/\//, "_", path)
  return tolower(path)
}

function Slug(title) {
  title = tolower(title)
  gsub(/[`*$\\(){}\[\],.:;?!'"\/+=<>&|^~#%@]/, "", title)
  gsub(/ /, "-", title)
  return title
}

function EscapeHtml(text) {
  gsub(/&/, "\\&amp;", text); gsub(/</, "\\&lt;", text); gsub(/>/, "\\&gt;", text)
  return text
}

# A bar would end a cell of a table.
function Formula(latex, kind) {
  gsub(/\|/, "\\vert ", latex); gsub(/\n/, " ", latex)
  has_formula = 1
  return "\\htmlonly<span class=\"" kind "\">" EscapeHtml(latex) "</span>\\endhtmlonly"
}

# The path `to`, as linked from this page, seen from the project's folder.
function Resolve(to,    parts, n, k, out, m) {
  n = split(folder to, parts, "/")
  m = 0
  for (k = 1; k <= n; ++k) {
    if (parts[k] == "..") --m
    else if (parts[k] != "." && parts[k] != "") out[++m] = parts[k]
  }
  to = out[1]
  for (k = 2; k <= m; ++k) to = to "/" out[k]
  return to
}

# Doxygen's name for the page with the text of a file.
function SourcePage(path) {
  sub(/^.*\//, "", path); gsub(/_/, "__", path); gsub(/\./, "_8", path)
  return path "_source.html"
}

function Link(target,    anchor, path) {
  if (target ~ /^(https?:|mailto:)/) return target
  anchor = ""
  if (match(target, /#.*/)) {
    anchor = substr(target, RSTART + 1)
    target = substr(target, 1, RSTART - 1)
  }
  path = target == "" ? page : Resolve(target)
  if (path ~ /^docs\/.*\.md$/) return "@ref " Label(path) (anchor == "" ? "" : "_" anchor)
  if (path ~ /^[a-z]+\/include\/.*\.h$/) return "@ref " substr(path, index(path, "/include/") + 9)
  if (path ~ /^examples\/[0-9].*\.cpp$/) return SourcePage(path)
  return ""  # nothing of the published pages: the text alone
}

# Links, pictures and formulas of a piece of text without code.
function Convert(text,    out, end, latex, target, label) {
  out = ""
  while (match(text, /\$\$?|!?\[[^]\[]*\]\([^)\n]*\)/)) {
    out = out substr(text, 1, RSTART - 1)
    found = substr(text, RSTART, RLENGTH)
    text = substr(text, RSTART + RLENGTH)
    if (found ~ /^\$/) {
      end = index(text, found)
      if (end == 0) { out = out found; continue }
      out = out Formula(substr(text, 1, end - 1), found == "$" ? "formula" : "formula display")
      text = substr(text, end + length(found))
      if (text ~ /^[A-Za-z0-9]/) out = out "&#8203;"
    } else if (found ~ /^!/) {
      target = found
      sub(/^.*\//, "", target)  # pictures lie beside the pages
      sub(/\)$/, "", target)
      label = found
      sub(/^!\[/, "", label); sub(/\]\(.*$/, "", label)
      out = out "\\htmlonly<img class=\"picture\" src=\"" target "\" alt=\"" EscapeHtml(label) "\"/>\\endhtmlonly"
    } else {
      label = found
      target = found
      sub(/\]\(.*$/, "", label); sub(/^\[/, "", label); sub(/\n */, " ", label)
      target = substr(target, index(target, "](") + 2); sub(/\)$/, "", target)
      target = Link(target)
      out = out (target == "" ? label : "[" label "](" target ")")
    }
  }
  return out text
}

# Text between pieces of `code`; a formula may hold none.
function ConvertText(text,    out, before, code) {
  out = ""
  while (match(text, /`[^`]*`/)) {
    before = substr(text, 1, RSTART - 1)
    code = substr(text, RSTART, RLENGTH)
    text = substr(text, RSTART + RLENGTH)
    if (index(code, "'")) code = "`" code "`"  # Doxygen takes `...' for a quotation
    out = out Convert(before) code
  }
  return out Convert(text)
}

function Flush() {
  if (held != "") printf "%s", ConvertText(held)
  held = ""
}

BEGIN {
  page = substr(ARGV[1], length(root) + 2)
  folder = page
  sub(/[^\/]*$/, "", folder)
  label = Label(page)
}

/^```/ { Flush(); fenced = !fenced; print; next }
fenced { print; next }
# Indented code, unless it goes on with an item of a list.
/^    / && (blank || coded) && !in_list { Flush(); coded = 1; print; next }
{ coded = 0 }
/^#+ / {
  Flush()
  title = $0
  sub(/^#+ */, "", title)
  marks = $0
  sub(/ .*/, "", marks)
  if (marks == "#" && label == "index") print  # Doxygen labels its main page itself
  else printf "%s %s {#%s}\n", marks, title, marks == "#" ? label : label "_" Slug(title)
  in_list = 0
  blank = 0
  next
}
{
  if ($0 ~ /^ *([-*]|[0-9]+\.) /) in_list = 1
  else if ($0 ~ /^[^ ]/) in_list = 0
  blank = ($0 ~ /^ *$/)
  held = held $0 "\n"
  if (blank) Flush()
}

END {
  Flush()
  if (has_formula) {
    print ""
    print "\\htmlonly"
    print "<link rel=\"stylesheet\" href=\"katex/katex.min.css\"/>"
    print "<script src=\"katex/katex.min.js\"></script>"
    print "<script src=\"formulas.js\"></script>"
    print "\\endhtmlonly"
  }
}
