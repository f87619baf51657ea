// SPDX-License-Identifier: GPL-3.0-or-later
#include "clients/cli/files.h"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <string_view>
#include <system_error>

#include "core/base/error.h"
#include "core/base/text.h"
#include "core/write/export.h"

namespace spherule::cli {

namespace fs = std::filesystem;

namespace {

[[noreturn]] void unreadable(const char* sentence = "The file cannot be opened; check its name and permissions.") {
  throw Error(ErrorCode::not_found, sentence);
}

// The name of the data file in a text header, without its folder; empty when there is none.
std::string named_data(const fs::path& header) {
  constexpr std::array<std::string_view, 3> keys = {"ElementDataFile", "data file", "datafile"};
  constexpr std::string_view blanks = " \t\r=";
  constexpr std::size_t most_lines = 1000, longest = 4096;
  std::ifstream in(header);
  std::array<char, longest> buffer{};
  for (std::size_t n = 0; n < most_lines && in.getline(buffer.data(), buffer.size()); ++n) {
    std::string_view line(buffer.data());
    const std::size_t end = line.find_first_of(":=");
    if (end == line.npos) continue;
    const std::string_view key = trimmed(line.substr(0, end), blanks), value = trimmed(line.substr(end + 1), blanks);
    if (std::ranges::find(keys, key) != keys.end()) return std::string(value.substr(value.find_last_of("/\\") + 1));
  }
  return {};
}

}  // namespace

void check_readable(const std::vector<fs::path>& files) {
  for (const fs::path& file : files) {
    std::error_code error;
    if (fs::is_directory(file, error)) unreadable("This is a folder; name the files in it.");
    if (::access(file.c_str(), R_OK) != 0) unreadable();
  }
}

void check_writable(const fs::path& file) {
  std::error_code error;
  const bool there = fs::exists(file, error);
  const fs::path folder = file.has_parent_path() ? file.parent_path() : fs::path(".");
  if (fs::is_directory(file, error) || ::access(there ? file.c_str() : folder.c_str(), W_OK) != 0) {
    throw Error(ErrorCode::no_space, "The output file cannot be written; check its folder and permissions.");
  }
}

void write_file(const fs::path& file, const std::string& bytes) {
  std::ofstream out(file, std::ios::binary | std::ios::trunc);
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  out.close();
  if (!out) throw Error(ErrorCode::no_space, "The output file cannot be written; check its folder and the space left.");
}

std::vector<Sphere> read_spheres(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) unreadable();
  std::string bytes;
  std::array<char, 1 << 16> piece{};
  while (in.read(piece.data(), piece.size()) || in.gcount() > 0) {
    bytes.append(piece.data(), static_cast<std::size_t>(in.gcount()));
  }
  if (in.bad()) unreadable("The file cannot be read to its end; check the disk that it is on.");
  return file.extension() == ".csv" ? spheres_from_csv(bytes) : spheres_from_npy(bytes);
}

std::vector<fs::path> with_data(std::vector<fs::path> files) {
  if (files.size() != 1) return files;
  const fs::path header = files.front();
  const std::string ending = header.extension().string();
  fs::path data;
  if (ending == ".hdr") data = fs::path(header).replace_extension(".img");
  if (ending == ".mhd" || ending == ".nhdr") {
    if (const std::string name = named_data(header); !name.empty()) data = header.parent_path() / name;
  }
  std::error_code error;
  if (!data.empty() && fs::is_regular_file(data, error)) files.push_back(data);
  return files;
}

}  // namespace spherule::cli
