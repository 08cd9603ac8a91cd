#!/bin/sh
# What must be on a machine before anything is downloaded, all that is missing in one message.
# check_machine.sh PYTHON [page]: with "page", Node.js must be there; without, its want is only told.
python=$1
missing=""
note="the web page cannot be built; the rest works without it"
miss() { missing="$missing
  - $1"; }

if ! "$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' 2> /dev/null; then
  miss "Python 3.11 to 3.14, which '$python' is not (another one: make PYTHON=/path/to/python3 ...)"
elif ! "$python" -c 'import ensurepip, os, sysconfig, venv; os.stat(sysconfig.get_path("include") + "/Python.h")' 2> /dev/null; then
  miss "the venv module and the C headers of '$python' (Debian: python3-venv and python3-dev)"
fi

program='#include <string_view>
int main() { if constexpr (sizeof(std::string_view) > 0) return 0; }'
compiles=""
for compiler in ${CXX:-c++ g++ clang++}; do
  echo "$program" | "$compiler" -std=c++17 -x c++ -fsyntax-only - 2> /dev/null && compiles=yes && break
done
test -n "$compiles" || miss "a C++17 compiler (Debian: g++)"
command -v make > /dev/null || miss "make"

fatal=$missing
if ! node -e 'const [a, b] = process.versions.node.split("."); process.exit(a > 18 || (a == 18 && b >= 19) ? 0 : 1)' 2> /dev/null \
  || ! command -v npm > /dev/null; then
  test -n "$2" && note="the web page cannot be built" && fatal=yes
  miss "Node.js 18.19 or later with npm ($note)"
fi

test -z "$missing" || echo "Missing on this machine:$missing" >&2
test -z "$fatal"
