// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/metaimage.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include "core/base/text.h"
#include "core/read/itk.h"
#include "core/read/read_bytes.h"
#include "core/read/read_header.h"

namespace spherule {

namespace {

[[noreturn]] void fail_malformed(const std::string& sentence) { throw Error(ErrorCode::malformed, sentence); }
[[noreturn]] void fail_unusable(const std::string& sentence) { throw Error(ErrorCode::unusable, sentence); }

struct Fields {
  std::map<std::string, std::string, std::less<>> value;
  std::vector<std::string> list;  // of data files
  std::size_t end = 0;            // of the header: where local data start
  bool complete = false;          // its last field was there
  bool untidy = false;            // fields that do not matter come first or repeat

  // Of fields that stay: what is found lies in them.
  const std::string* find(std::string_view name) const& {
    const auto found = value.find(name);
    return found == value.end() ? nullptr : &found->second;
  }
  // The first of the names that a field goes by.
  const std::string* find(std::initializer_list<std::string_view> names) const& {
    for (const std::string_view name : names) {
      if (const std::string* found = find(name)) return found;
    }
    return nullptr;
  }
  const std::string* find(std::string_view name) const&& = delete;
  const std::string& at(std::string_view name) const& {
    if (const std::string* found = find(name)) return *found;
    fail_malformed("The MetaImage header lacks NDims, DimSize, ElementType or ElementDataFile; correct the header.");
  }
  bool flag(std::initializer_list<std::string_view> names, bool otherwise) const {
    const std::string* found = find(names);
    return found && !found->empty() ? (*found)[0] == 'T' || (*found)[0] == 't' || (*found)[0] == '1' : otherwise;
  }
};

// The fields that matter here; others, such as comments and what programs add, are passed over without being kept.
bool is_used(std::string_view name) {
  constexpr std::array<std::string_view, 20> kNames{"ObjectType",
                                                    "NDims",
                                                    "DimSize",
                                                    "ElementType",
                                                    "ElementDataFile",
                                                    "HeaderSize",
                                                    "ElementSpacing",
                                                    "ElementSize",
                                                    "Offset",
                                                    "Position",
                                                    "Origin",
                                                    "TransformMatrix",
                                                    "Rotation",
                                                    "Orientation",
                                                    "BinaryData",
                                                    "BinaryDataByteOrderMSB",
                                                    "CompressedData",
                                                    "DistanceUnits",
                                                    "ElementByteOrderMSB",
                                                    "ElementNumberOfChannels"};
  return std::ranges::find(kNames, name) != kNames.end();
}

struct Line {
  std::string_view name, value;
};

// Nothing for an empty line.
std::optional<Line> parse_line(std::string_view line) {
  if (trimmed(line).empty()) return std::nullopt;
  const std::size_t equals = line.find('=');
  const std::string_view name = trimmed(line.substr(0, equals));
  if (equals == std::string_view::npos || name.empty() || name.size() > 80) {
    fail_malformed("The MetaImage header has a line that is not a field; correct the header.");
  }
  return Line{name, trimmed(line.substr(equals + 1))};
}

Fields parse_fields(std::string_view text, std::size_t most_files) {
  Fields fields;
  std::string_view rest = text;
  std::set<std::string, std::less<>> others;
  constexpr std::size_t kMostOthers = 1000;
  while (!rest.empty()) {
    const std::optional<Line> line = parse_line(next_line(rest));
    if (!line) continue;
    const auto& [name, value] = *line;
    if (!is_used(name)) {
      fields.untidy = fields.untidy || fields.value.empty() || others.contains(name);
      if (others.size() < kMostOthers) others.emplace(name);
      continue;
    }
    if (value.size() > max_header_value)
      fail_malformed("The MetaImage header has a field that is longer than any needs; correct it.");
    if (!fields.value.emplace(name, value).second) {
      fail_malformed("The MetaImage header says the same field twice; correct the header.");
    }
    if (name != "ElementDataFile") continue;
    fields.complete = true;
    fields.end = text.size() - rest.size();
    if (value.starts_with("LIST")) {
      while (!rest.empty() && fields.list.size() <= most_files) {
        if (const std::string_view file = trimmed(next_line(rest)); !file.empty()) fields.list.emplace_back(file);
      }
      if (fields.list.size() > most_files) {
        fail_malformed(
            "The MetaImage header names more data files than were sent; send the header and all its data files "
            "together.");
      }
    }
    break;
  }
  return fields;
}

bool is_local(std::string_view data) { return data == "LOCAL" || data == "Local" || data == "local"; }

// The numbers of one axis each, for three axes: a fourth is left out, a missing third is `flat`.
std::string three(const std::string& text, std::size_t rank, double flat) {
  std::vector<double> values = header_numbers(text, rank);
  values.resize(3, flat);
  return joined(values);
}

std::string spacing(const std::string& text, std::size_t rank) {
  for (const std::string_view word : words(text)) {
    if (!(header_number(word) > 0)) {
      fail_unusable("Every spacing in the MetaImage header must be above zero; correct the header.");
    }
  }
  return three(text, rank, 1);
}

std::string matrix(const std::string& text, std::size_t rank) {
  const std::vector<double> all = header_numbers(text, rank * rank);
  std::vector<double> part{1, 0, 0, 0, 1, 0, 0, 0, 1};
  const std::size_t n = std::min<std::size_t>(rank, 3);
  for (std::size_t r = 0; r < n; ++r) {
    for (std::size_t c = 0; c < n; ++c) part[3 * r + c] = all[rank * r + c];
  }
  return joined(part);
}

// How the samples lie in a file; which files, is left open.
SampleSource layout_of(const Fields& fields, const ReadLimits& limits) {
  SampleSource source;
  // Packed samples are binary, whatever BinaryData says: so ITK reads them.
  if (fields.flag({"CompressedData"}, false)) {
    source.packing = Packing::deflate;
  } else if (!fields.flag({"BinaryData"}, true)) {
    source.packing = Packing::text;
  }
  source.big_endian = fields.flag({"BinaryDataByteOrderMSB", "ElementByteOrderMSB"}, false);
  if (const std::string* size = fields.find("HeaderSize")) {
    const std::int64_t bytes = header_integer(*size);
    if (bytes < -1 || bytes > static_cast<std::int64_t>(limits.max_bytes) ||
        (bytes == -1 && source.packing != Packing::none)) {
      fail_malformed("The MetaImage header's HeaderSize is not possible; correct the header.");
    }
    source.at_end = bytes == -1;
    if (bytes > 0) source.offset = static_cast<std::uint64_t>(bytes);
  }
  return source;
}

SampleSource source_of(const Fields& fields, const std::filesystem::path& header,
                       const std::vector<std::filesystem::path>& files, std::int64_t frames, Volume& volume,
                       const ReadLimits& limits, const Context& context) {
  SampleSource source = layout_of(fields, limits);
  source.frames = frames;
  const std::string& data = fields.at("ElementDataFile");
  const auto word = words(data);
  if (is_local(data)) {
    if (source.offset == 0) source.offset = fields.end;
    source.files = {header};
  } else if (data.starts_with("LIST")) {
    source.files = named_files(fields.list, files);
    if (source.files.empty()) fail_malformed("The MetaImage header's list of data files is empty; correct the header.");
  } else if (data.find('%') != std::string::npos && word.size() >= 4) {
    source.files = named_files(numbered_names(word[0], std::span(word).subspan(1, 3), files.size()), files);
  } else {
    const auto fits = [&](const std::filesystem::path& file) {
      SampleSource of = source;
      of.files = {file};
      return holds_exactly(volume, of, context);
    };
    source.files = {data_file(data, header, files, fits, volume.warnings)};
  }
  return source;
}

}  // namespace

bool is_metaimage(std::string_view head) {
  // Programs add fields of their own, also in front: any line of `key = value` may come before.
  try {
    while (!head.empty()) {
      const std::optional<Line> line = parse_line(next_line(head));
      if (line && (line->name == "NDims" || line->name == "ObjectType")) return true;
      if (line && !std::ranges::all_of(line->name, [](char c) { return c >= ' ' && c <= '~'; })) return false;
    }
  } catch (const Error&) {
  }
  return false;
}

bool is_detached_metaimage(std::string_view head) {
  try {
    if (!is_metaimage(head)) return false;
    const Fields fields = parse_fields(head, head.size());
    const std::string* data = fields.find("ElementDataFile");
    return data && !is_local(*data);
  } catch (const Error&) {
    return false;
  }
}

Volume read_metaimage(const std::filesystem::path& header, const std::vector<std::filesystem::path>& files,
                      const ReadOptions& options, const Context& context) {
  const std::string text = read_text(header, Packing::none, options.limits.max_header_bytes);
  const Fields fields = parse_fields(text, files.size());
  if (!fields.complete && text.size() == options.limits.max_header_bytes) {
    throw Error(ErrorCode::too_large,
                "The MetaImage header is longer than allowed; remove what the volume does not need.");
  }
  if (const std::string* object = fields.find("ObjectType"); object && *object != "Image") {
    fail_unusable("The MetaIO object is not an image; send a file with ObjectType = Image.");
  }
  const std::int64_t dimensions = header_integer(fields.at("NDims"));
  if (dimensions < 2 || dimensions > 4) fail_unusable("The MetaImage header's NDims must be 2, 3 or 4; reshape it.");
  const auto rank = static_cast<std::size_t>(dimensions);
  std::vector<std::int64_t> sizes = header_integers(fields.at("DimSize"), rank);
  if (std::ranges::any_of(sizes, [](std::int64_t n) { return n < 1; })) {
    fail_unusable("Every size in the MetaImage header must be at least 1; correct the header.");
  }
  sizes.resize(4, 1);
  if (const std::string* channels = fields.find("ElementNumberOfChannels");
      channels && header_integer(*channels) != 1) {
    fail_unusable("The file holds colours or vectors, not one scalar a voxel; split it into one volume each.");
  }
  const std::string& type = fields.at("ElementType");
  if (!type.starts_with("MET_") || type.find_first_not_of("ABCDEFGHIJKLMNOPQRSTUVWXYZ_") != std::string::npos) {
    fail_malformed("The MetaImage header's ElementType is unknown; correct the header.");
  }

  std::string clean = "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n";
  if (const std::string* m = fields.find({"TransformMatrix", "Rotation", "Orientation"})) {
    clean += "TransformMatrix = " + matrix(*m, rank) + "\n";
  }
  if (const std::string* origin = fields.find({"Offset", "Position", "Origin"})) {
    clean += "Offset = " + three(*origin, rank, 0) + "\n";
  }
  if (const std::string* step = fields.find({"ElementSpacing", "ElementSize"})) {
    clean += "ElementSpacing = " + spacing(*step, rank) + "\n";
  }
  // Limits for the smallest type first: ITK narrows sizes without a word.
  checked_dims({sizes[0], sizes[1], sizes[2]}, VoxelType::uint8, options.limits);
  clean += "DimSize =";
  for (std::size_t a = 0; a < 3; ++a) (clean += ' ') += std::to_string(sizes[a]);
  clean += "\nElementType = " + type + "\nElementDataFile = LOCAL\n";
  const ItkHeader parsed = parse_with_itk(ItkFormat::metaimage, clean);

  Volume volume;
  volume.format = "metaimage";
  volume.type = parsed.type;
  if (fields.untidy) {
    volume.warnings.emplace_back(
        "The MetaImage header starts with fields that do not matter for the volume, or repeats such; they were "
        "ignored.");
  }
  const std::string* units = fields.find("DistanceUnits");
  const double unit = units ? millimetres_or_one(*units, volume.warnings) : 1;
  Mat3 axes = parsed.axes;
  for (Vec3& row : axes.rows) row = unit * row;
  volume.grid = grid_from_affine(checked_dims(parsed.dims, volume.type, options.limits), axes, unit * parsed.origin);
  SampleSource source = source_of(fields, header, files, sizes[3], volume, options.limits, context);
  source.frame = chosen_frame(sizes[3], options);
  read_samples(volume, source, context);
  return volume;
}

}  // namespace spherule
