#!/usr/bin/env bash
# Does a change of the product say so for the changelog? `release/check_fragments.sh [BASE]` in a checkout with its history.
# Fails where files of the product differ from BASE, a revision, and no fragment changes/+NAME.KIND.md was added or changed
# since, nor the changelog. BASE is by default the last release's tag v*, or where none is, the commit that last changed the version.
set -euo pipefail
cd "$(git rev-parse --show-toplevel)"

base=${1:-$(git describe --tags --abbrev=0 --match 'v[0-9]*' 2> /dev/null || true)}
base=${base:-$(git log -1 --format=%h -G'^version = ' -- pyproject.toml)}
# What is beside the product: its tests, what documents, measures and releases it, and what makes these run.
beside=(tests docs benchmarks release examples changes .ci '*.md' '*.test.ts' Makefile mkdocs.yml CITATION.cff)
changed() { git diff --merge-base --name-only "$@"; }
product=$(changed "$base" -- . "${beside[@]/#/:!}")
[[ -z $product || -n $(changed --diff-filter=AMR "$base" -- 'changes/+*.md' CHANGELOG.md) ]] && exit
echo "These files of the product changed since $base, and no fragment says so. Add changes/+NAME.KIND.md (see DEVELOPMENT.md):" >&2
echo "$product" >&2
exit 1
