// SPDX-License-Identifier: GPL-3.0-or-later
//
// The command line, parsed.
#pragma once

#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/base/option_texts.h"
#include "core/inside.h"
#include "core/read/read.h"
#include "core/register/solve.h"
#include "core/render/render.h"
#include "core/simplify/simplify.h"

namespace spherule::cli {

/// The command line makes no sense; the message is one sentence. Exit status 2.
struct UsageError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// What is to be done, to what and how.
struct Options {
  std::string command;  ///< info, points, model, simplify, register, measures, checks, render or export
  std::vector<std::filesystem::path> files;  ///< at least one
  std::vector<std::filesystem::path> fixed;  ///< for register: the files of the other volume
  TransformKind transform = TransformKind::similarity;
  ReadOptions read;
  std::optional<ObjectRule> rule;  ///< without its side, which `side` or else the volume decides
  std::optional<Side> side;
  std::optional<SimplifyMethod> method;
  RenderOptions render;
  std::filesystem::path out;  ///< empty: nothing is written
  OptionTexts file;           ///< of the file's format (core/write/export_file.h), by its names
  unsigned threads = 1;
  bool plain = false;  ///< "key value" lines for scripts
  std::string help;    ///< not empty: what is asked for is this text, and nothing else is set
};

/// Throws UsageError, and what parse_method and parse_render_options throw: all before anything is read or computed.
Options parse(int argc, char** argv);

}  // namespace spherule::cli
