// SPDX-License-Identifier: GPL-3.0-or-later
#include <array>
#include <charconv>
#include <optional>

#include "core/base/text.h"
#include "core/write/decimal.h"
#include "core/write/export.h"
#include "core/write/import_check.h"

namespace spherule {
namespace {

constexpr std::string_view kBlanks = " \t";

// R and pandas may quote the names of columns.
std::string_view unquoted(std::string_view text) {
  return text.size() >= 2 && text.front() == '"' && text.back() == '"' ? text.substr(1, text.size() - 2) : text;
}

// Takes the text up to `separator` (or all of it) off the front of `rest`.
std::string_view take(std::string_view& rest, char separator) {
  const auto end = rest.find(separator);
  const std::string_view part = rest.substr(0, end);
  rest = end == std::string_view::npos ? std::string_view{} : rest.substr(end + 1);
  return part;
}

[[noreturn]] void malformed(std::size_t line, const std::string& what) {
  throw Error(ErrorCode::malformed, "Line " + std::to_string(line) + " of the CSV " + what);
}

// Which of x, y, z, r (0 to 3) each column holds; none for columns to ignore.
using Columns = std::vector<std::optional<std::size_t>>;

Columns parse_header(std::string_view line, std::size_t number) {
  constexpr std::string_view kNames = "xyzr";
  // A header of many commas must not take more memory than the body it came in.
  constexpr std::size_t kMaxColumns = 1000;
  Columns columns;
  std::array<bool, 4> seen{};
  for (bool more = true; more;) {
    more = line.find(',') != std::string_view::npos;
    const std::string_view name = unquoted(trimmed(take(line, ','), kBlanks));
    const auto which = name.size() == 1 ? kNames.find(name.front()) : std::string_view::npos;
    if (which == std::string_view::npos) {
      columns.push_back(std::nullopt);
    } else {
      if (seen[which]) malformed(number, "names the column " + std::string(name) + " twice: name it once.");
      seen[which] = true;
      columns.push_back(which);
    }
    if (columns.size() > kMaxColumns) malformed(number, "has more than 1000 columns: send x,y,z,r.");
  }
  for (const bool found : seen)
    if (!found) malformed(number, "is not a header that names the columns x, y, z and r, separated by commas.");
  return columns;
}

Sphere parse_row(std::string_view line, const Columns& columns, std::size_t number) {
  std::array<double, 4> values{};
  std::size_t column = 0;
  for (bool more = true; more; ++column) {
    more = line.find(',') != std::string_view::npos;
    const std::string_view field = trimmed(take(line, ','), kBlanks);
    if (column >= columns.size()) malformed(number, "has more fields than the header has columns.");
    if (!columns[column]) continue;
    const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), values[*columns[column]],
                                              std::chars_format::general);
    if (field.empty() || error != std::errc{} || end != field.data() + field.size())
      malformed(number, "has a field where a decimal number such as -12.5 is expected.");
  }
  if (column < columns.size()) malformed(number, "has fewer fields than the header has columns.");
  return {{values[0], values[1], values[2]}, values[3]};
}

}  // namespace

std::string spheres_to_csv(std::span<const Sphere> spheres, std::span<const SphereColumn> columns) {
  std::string out =
      "# Spherule: centres and radii of spheres\n"
      "# frame: LPS (x to the patient's left, y to the posterior, z to the head)\n"
      "# units: mm\n"
      "x,y,z,r";
  for (const SphereColumn& column : columns) out += ',' + column.name;
  out += '\n';
  out.reserve(out.size() + (80 + 20 * columns.size()) * spheres.size());
  const auto append = [&](double value) { detail::append_decimal(out, value); };
  for (std::size_t i = 0; i < spheres.size(); ++i) {
    const Sphere& s = spheres[i];
    append(s.centre.x);
    for (const double value : {s.centre.y, s.centre.z, s.radius}) out += ',', append(value);
    for (const SphereColumn& column : columns) out += ',', append(column.values[i]);
    out += '\n';
  }
  return out;
}

std::vector<Sphere> spheres_from_csv(std::string_view bytes, const ImportLimits& limits) {
  constexpr std::string_view kByteOrderMark = "\xef\xbb\xbf";
  if (bytes.starts_with(kByteOrderMark)) bytes.remove_prefix(kByteOrderMark.size());
  std::optional<Columns> columns;
  std::vector<Sphere> spheres;
  for (std::size_t number = 1; !bytes.empty(); ++number) {
    std::string_view line = take(bytes, '\n');
    if (line.ends_with('\r')) line.remove_suffix(1);
    line = trimmed(line, kBlanks);
    if (line.empty() || line.front() == '#') continue;
    if (!columns) {
      columns = parse_header(line, number);
      continue;
    }
    const Sphere sphere = parse_row(line, *columns, number);
    detail::require_usable(sphere, spheres.size() + 1);
    detail::require_within(spheres.size() + 1, limits);
    spheres.push_back(sphere);
  }
  detail::require_some(spheres.size());
  return spheres;
}

}  // namespace spherule
