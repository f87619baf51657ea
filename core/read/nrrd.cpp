// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/nrrd.h"

#include <algorithm>
#include <map>
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
  std::map<std::string, std::string> value;  // by name: lower case, without blanks
  std::vector<std::string> list;             // of data files
  std::size_t end = 0;                       // of the header: where attached data start
  bool attached = false;

  // Of fields that stay: what is found lies in them.
  const std::string* find(const std::string& name) const& {
    const auto found = value.find(name);
    return found == value.end() ? nullptr : &found->second;
  }
  const std::string* find(const std::string& name) const&& = delete;
  const std::string& at(const std::string& name) const& {
    if (const std::string* found = find(name)) return *found;
    fail_malformed("The NRRD header lacks its type, dimension, sizes, encoding or byte order; correct the header.");
  }
};

// The fields that matter here; others are passed over without being kept.
bool is_used(const std::string& name) {
  static const std::set<std::string> names{
      "type",  "dimension",   "sizes",      "spacings",       "axismins",    "axismaxs",       "centerings",
      "units", "thicknesses", "datafile",   "endian",         "encoding",    "lineskip",       "byteskip",
      "kinds", "space",       "spaceunits", "spacedimension", "spaceorigin", "spacedirections"};
  return names.contains(name);
}

Fields parse_fields(std::string_view text, std::size_t most_files) {
  Fields fields;
  std::string_view rest = text;
  next_line(rest);  // the magic
  while (!rest.empty()) {
    const std::string_view line = next_line(rest);
    if (line.empty()) {
      fields.attached = true;
      break;
    }
    if (line[0] == '#') continue;
    const std::size_t colon = line.find(':');
    if (colon == std::string_view::npos) {
      fail_malformed("The NRRD header has a line that is neither a field nor a comment; correct the header.");
    }
    std::string name = lowered(line.substr(0, std::min<std::size_t>(colon, 80)));
    std::erase(name, ' ');
    if (name == "centers") name = "centerings";
    // Keys of key:=value pairs may hold colons.
    if (line.substr(colon).starts_with(":=") || !is_used(name)) continue;
    const std::string_view value = trimmed(line.substr(colon + 1));
    if (value.size() > max_header_value)
      fail_malformed("The NRRD header has a field that is longer than any needs; correct it.");
    if (!fields.value.emplace(name, value).second) {
      fail_malformed("The NRRD header says the same field twice; correct the header.");
    }
    if (name == "datafile" && value.starts_with("LIST")) {
      while (!rest.empty() && fields.list.size() <= most_files) {
        if (const std::string_view file = trimmed(next_line(rest)); !file.empty()) fields.list.emplace_back(file);
      }
      if (fields.list.size() > most_files) {
        fail_malformed(
            "The NRRD header names more data files than were sent; send the header and all its data files together.");
      }
    }
  }
  fields.end = text.size() - rest.size();
  return fields;
}

// "(a,b,c)" or "none"; blanks may stand within the brackets.
std::vector<std::vector<double>> vectors(std::string_view text) {
  std::vector<std::vector<double>> found;
  while (!(text = trimmed(text)).empty()) {
    if (text.starts_with("none")) {
      found.emplace_back();
      text.remove_prefix(4);
      continue;
    }
    const std::size_t close = text.find(')');
    if (text[0] != '(' || close == std::string_view::npos) {
      fail_malformed("The NRRD header's space directions or origin do not parse; write them as (x,y,z).");
    }
    std::string inner(text.substr(1, close - 1));
    const auto commas = static_cast<std::size_t>(std::ranges::count(inner, ','));
    std::ranges::replace(inner, ',', ' ');
    found.push_back(header_numbers(inner, commas + 1));
    text.remove_prefix(close + 1);
  }
  return found;
}

// One axis of the array, and what the header says about it.
struct Axis {
  enum class Role : std::uint8_t {
    untold,
    space,
    series,    ///< one volume after another: time, lists of layers
    component  ///< colours, vectors
  };
  std::int64_t size = 1;
  Role role = Role::untold;
  std::vector<double> direction{};  ///< of one step, in the header's space; empty when there is none
};
using Role = Axis::Role;

Role role_of_kind(const std::string& kind) {
  if (kind == "domain" || kind == "space") return Role::space;
  if (kind == "list" || kind == "time") return Role::series;
  if (kind == "???" || kind == "none" || kind == "stub" || kind == "scalar") return Role::untold;
  return Role::component;
}

std::vector<Axis> declared_axes(const Fields& fields) {
  const std::int64_t dimension = header_integer(fields.at("dimension"));
  if (dimension < 1 || dimension > 16)
    fail_malformed("The NRRD header's dimension must be within 1 and 16; correct it.");
  const auto rank = static_cast<std::size_t>(dimension);
  std::vector<Axis> axes;
  for (const std::int64_t n : header_integers(fields.at("sizes"), rank)) {
    if (n < 1) fail_unusable("Every size in the NRRD header must be at least 1; correct the header.");
    axes.push_back({.size = n});
  }
  if (const std::string* kinds = fields.find("kinds")) {
    const auto kind = words(*kinds);
    if (kind.size() != rank) fail_malformed("The NRRD header needs one kind an axis; correct the header.");
    for (std::size_t a = 0; a < rank; ++a) axes[a].role = role_of_kind(lowered(kind[a]));
  }
  if (const std::string* directions = fields.find("spacedirections")) {
    const auto direction = vectors(*directions);
    if (direction.size() != rank)
      fail_malformed("The NRRD header needs one space direction an axis; correct the header.");
    for (std::size_t a = 0; a < rank; ++a) {
      axes[a].direction = direction[a];
      if (direction[a].empty() && axes[a].role != Role::component) axes[a].role = Role::series;
      if (!direction[a].empty() && axes[a].role == Role::untold) axes[a].role = Role::space;
    }
  } else if (const std::string* spacings = fields.find("spacings")) {
    // An axis that is not of space has no spacing.
    const auto word = words(*spacings);
    for (std::size_t a = 0; a < std::min(rank, word.size()); ++a) {
      if (lowered(word[a]) == "nan" && axes[a].role == Role::untold) axes[a].role = Role::series;
    }
  }
  return axes;
}

// Of a space of four dimensions the fourth is time: steps are either through space or through time alone.
void part_time_from_space(std::vector<Axis>& axes) {
  for (Axis& axis : axes) {
    if (axis.role != Role::space || axis.direction.size() != 4) continue;
    const bool in_space = axis.direction[0] != 0 || axis.direction[1] != 0 || axis.direction[2] != 0;
    if (axis.direction[3] == 0) continue;
    if (in_space) fail_unusable("The NRRD header's space directions mix space with time; correct the header.");
    axis.role = Role::series;
  }
}

// Which axes are of space, fastest first, and how the volumes of a series lie in the array.
struct Axes {
  std::vector<Axis> all;
  std::vector<std::size_t> space;
  std::int64_t frames = 1;
  std::uint64_t run = 0;  // samples of one volume side by side; 0: all of them
};

Axes axes_of(const Fields& fields) {
  Axes axes{.all = declared_axes(fields), .space = {}};
  std::vector<Axis>& all = axes.all;
  const auto untold = [](const Axis& axis) { return axis.role == Role::untold; };
  const bool told = fields.find("spacings") || fields.find("axismins") || fields.find("thicknesses") ||
                    !std::ranges::all_of(all, untold);
  if (!told && all.size() == 3 && (all[0].size == 3 || all[0].size == 4)) {
    fail_unusable(
        "The file looks like a colour picture (3 or 4 samples along its fastest axis, and nothing says that this is an "
        "axis of space); if it is a volume, add spacings to the header.");
  }
  part_time_from_space(all);
  // Beyond three axes one of a single sample in front counts components, and the slowest one volumes.
  if (all.size() > 3 && untold(all.front()) && all.front().size == 1) all.front().role = Role::component;
  for (Axis& axis : all) {
    if (untold(axis)) axis.role = Role::space;
  }
  const auto spatial = [&] { return std::ranges::count(all, Role::space, &Axis::role); };
  for (std::size_t a = all.size(); a-- > 0 && spatial() > 3;) {
    if (all[a].role != Role::space) continue;
    if (all[a].size > 1 && spatial() > 4) break;
    all[a].role = Role::series;
  }
  std::uint64_t run = 1;
  for (std::size_t a = 0; a < all.size(); ++a) {
    if (all[a].role == Role::space) {
      axes.space.push_back(a);
    } else if (all[a].size > 1) {
      if (all[a].role == Role::component || axes.frames > 1 || spatial() > 3) {
        fail_unusable(
            "The file holds colours, vectors or too many dimensions, not one scalar a voxel; split it into one volume "
            "each.");
      }
      axes.frames = all[a].size;
      axes.run = run;
    }
    // Kept from overflowing: what is so large is refused by the limits below.
    run = std::min<std::uint64_t>(run, std::uint64_t{1} << 32) *
          std::min<std::uint64_t>(static_cast<std::uint64_t>(all[a].size), std::uint64_t{1} << 31);
  }
  if (axes.space.size() != 2 && axes.space.size() != 3)
    fail_unusable("The file must have two or three axes of space; reshape it.");
  return axes;
}

// The per-axis numbers of a field for the axes of space, with `flat` for the third of a flat picture.
std::vector<double> per_axis(const std::string& text, const Axes& axes, double flat) {
  const auto word = words(text);
  if (word.size() != axes.all.size()) fail_malformed("The NRRD header needs one number an axis; correct the header.");
  std::vector<double> values;
  for (const std::size_t a : axes.space) values.push_back(header_number(word[a]));
  values.resize(3, flat);
  return values;
}

struct Space {
  Vec3 signs;                  // from the header's frame to LPS
  std::size_t dimensions = 3;  // 4: the fourth is time
};

Space space_of(const Fields& fields, std::vector<std::string>& warnings) {
  std::string name = fields.find("space") ? lowered(*fields.find("space")) : "";
  Space space{.signs = {1, 1, 1}};
  for (const auto& [brief, whole] : {std::pair{"rast", "ras"}, {"last", "las"}, {"lpst", "lps"}}) {
    if (name == brief) name = std::string(whole) + "-time";
  }
  if (name.ends_with("-time")) {
    space.dimensions = 4;
    name.erase(name.size() - 5);
  } else if (const std::string* dimensions = fields.find("spacedimension")) {
    const std::int64_t n = header_integer(*dimensions);
    if (n < 2 || n > 4) fail_unusable("The NRRD header's space must be of three dimensions; correct it.");
    space.dimensions = static_cast<std::size_t>(n);
  } else if (name.empty() && fields.find("spacedirections")) {
    for (const auto& direction : vectors(*fields.find("spacedirections"))) {
      if (!direction.empty()) space.dimensions = direction.size();
    }
  }
  if (name == "left-posterior-superior" || name == "lps") return space;
  if (name == "right-anterior-superior" || name == "ras") {
    space.signs = {-1, -1, 1};
  } else if (name == "left-anterior-superior" || name == "las") {
    space.signs = {1, -1, 1};
  } else {
    warnings.push_back(
        "The NRRD header does not say how the volume lies in the patient; its axes were taken as left, posterior, "
        "superior.");
  }
  return space;
}

// A vector of the header's space, without time.
std::string spatial(const std::vector<double>& v, const Space& space) {
  if (v.size() != space.dimensions || v.size() < 2 || v.size() > 4)
    fail_unusable("The NRRD header's space must be of three dimensions; correct it.");
  std::vector<double> three(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(std::min<std::size_t>(v.size(), 3)));
  three.resize(3, 0);
  std::string text = "(";
  text += joined(three);
  text += ")";
  std::ranges::replace(text, ' ', ',');
  return text;
}

std::string directions_of(const Fields& fields, const Axes& axes, const Space& space) {
  if (fields.find("spacings")) {
    fail_malformed("The NRRD header says both spacings and space directions; keep one of them.");
  }
  std::vector<std::vector<double>> steps;
  for (const std::size_t a : axes.space) steps.push_back(axes.all[a].direction);
  // Always LPS here: the frame is changed by us, because ITK 5.2 mirrors the wrong axis of left-anterior-superior.
  std::string text = "space: left-posterior-superior\nspace directions:";
  for (const auto& step : steps) (text += ' ') += spatial(step, space);
  if (steps.size() == 2) {
    const auto vec = [](const std::vector<double>& v) { return Vec3{v[0], v[1], v.size() > 2 ? v[2] : 0}; };
    const Vec3 normal = cross(vec(steps[0]), vec(steps[1]));
    const double length = norm(normal);
    if (!(length > 0)) fail_unusable("The NRRD header's space directions are singular; correct the header.");
    (text += ' ') += spatial({normal.x / length, normal.y / length, normal.z / length}, {.signs = {}});
  }
  text += "\n";
  if (const std::string* origin = fields.find("spaceorigin")) {
    const auto values = vectors(*origin);
    if (values.size() != 1) fail_malformed("The NRRD header's space origin must be one vector; correct the header.");
    text += "space origin: " + spatial(values[0], space) + "\n";
  }
  return text;
}

std::string spacings_of(const Fields& fields, const Axes& axes) {
  // The space is left out here: ITK refuses it beside spacings, though NRRD allows both.
  std::string text;
  if (const std::string* spacings = fields.find("spacings")) {
    const std::vector<double> values = per_axis(*spacings, axes, 1);
    if (std::ranges::any_of(values, [](double v) { return !(v > 0); })) {
      fail_unusable("Every spacing in the NRRD header must be above zero; correct the header.");
    }
    text += "spacings: " + joined(values) + "\n";
  } else if (fields.find("axismaxs")) {
    fail_unusable("The NRRD header gives axis maxs but no spacings; write spacings or space directions.");
  }
  if (const std::string* mins = fields.find("axismins")) {
    text += "axis mins: " + joined(per_axis(*mins, axes, 0)) + "\n";
    if (const std::string* centerings = fields.find("centerings")) {
      const auto word = words(*centerings);
      if (word.size() != axes.all.size()) fail_malformed("The NRRD header needs one centering an axis; correct it.");
      text += "centerings:";
      for (std::size_t n = 0; n < 3; ++n) {
        const std::string w = n < axes.space.size() ? lowered(word[axes.space[n]]) : std::string("cell");
        text += w == "node" ? " node" : w == "cell" ? " cell" : " ???";
      }
      text += "\n";
    }
  }
  return text;
}

// The words of `"mm" "a unit" mm`.
std::vector<std::string> quoted_words(std::string_view text) {
  std::vector<std::string> found;
  while (!(text = trimmed(text)).empty()) {
    const bool quoted = text[0] == '"';
    if (quoted) text.remove_prefix(1);
    const std::size_t end = std::min(quoted ? text.find('"') : text.find_first_of(" \t\""), text.size());
    found.emplace_back(text.substr(0, end));
    text.remove_prefix(std::min(text.size(), end + (quoted ? 1 : 0)));
  }
  return found;
}

// Millimetres in the header's units along each axis of its space; where it has none (spacings), along each of the grid.
Vec3 units_of(const Fields& fields, const Axes& axes, std::vector<std::string>& warnings) {
  const bool directed = fields.find("spacedirections");
  const std::string* world = fields.find("spaceunits");
  const std::string* each = fields.find("units");
  Vec3 mm{1, 1, 1};
  if (world && (directed || !each)) {
    const auto unit = quoted_words(*world);
    for (std::size_t n = 0; n < std::min<std::size_t>(3, unit.size()); ++n)
      mm[static_cast<int>(n)] = millimetres_or_one(unit[n], warnings);
  } else if (each) {
    const auto unit = quoted_words(*each);
    if (unit.size() != axes.all.size()) fail_malformed("The NRRD header needs one unit an axis; correct the header.");
    for (std::size_t n = 0; n < axes.space.size(); ++n)
      mm[static_cast<int>(n)] = millimetres_or_one(unit[axes.space[n]], warnings);
    if (axes.space.size() == 2) mm.z = mm.y;
    if (directed && !(mm.x == mm.y && mm.y == mm.z)) {
      fail_unusable("The NRRD header's units differ from axis to axis; write space units instead.");
    }
  }
  return mm;
}

std::size_t offset_behind_lines(const std::filesystem::path& file, std::size_t from, std::int64_t lines,
                                const ReadLimits& limits) {
  if (lines == 0) return from;
  const std::string text = read_text(file, Packing::none, limits.max_header_bytes);
  std::size_t at = std::min(from, text.size());
  for (; lines > 0; --lines) {
    at = text.find('\n', at);
    if (at == std::string::npos) fail_malformed("The NRRD header skips more lines than the data have; correct it.");
    ++at;
  }
  return at;
}

Packing packing_of(const std::string& encoding) {
  if (encoding == "raw") return Packing::none;
  if (encoding == "gzip" || encoding == "gz") return Packing::deflate;
  if (encoding == "bzip2" || encoding == "bz2") return Packing::bzip2;
  if (encoding == "ascii" || encoding == "text" || encoding == "txt") return Packing::text;
  if (encoding == "hex") return Packing::hex;
  fail_unusable(encoding == "zrl" ? "The NRRD encoding zrl is not read; save the file as raw or gzip."
                                  : "Only the NRRD encodings raw, ascii, hex, gzip and bzip2 are read; save the file "
                                    "with one of them.");
}

// How the samples lie in a file; which files, is left open.
SampleSource layout_of(const Fields& fields, VoxelType type, const ReadLimits& limits) {
  SampleSource source;
  source.packing = packing_of(lowered(fields.at("encoding")));
  if (bytes_per_voxel(type) > 1 && source.packing != Packing::text) {
    const std::string endian = lowered(fields.at("endian"));
    if (endian != "little" && endian != "big") fail_malformed("The NRRD header's endian must be little or big.");
    source.big_endian = endian == "big";
  }
  const std::string* byte_skip = fields.find("byteskip");
  const std::int64_t bytes = byte_skip ? header_integer(*byte_skip) : 0;
  if (bytes < -1 || bytes > static_cast<std::int64_t>(limits.max_bytes) ||
      (bytes != 0 && source.packing == Packing::text)) {
    fail_malformed("The NRRD header's byte skip is not possible; correct the header.");
  }
  source.at_end = bytes == -1;
  source.skip = static_cast<std::uint64_t>(std::max<std::int64_t>(bytes, 0));
  return source;
}

SampleSource source_of(const Fields& fields, const std::filesystem::path& header,
                       const std::vector<std::filesystem::path>& files, const Axes& axes, Volume& volume,
                       const ReadLimits& limits, const Context& context) {
  SampleSource source = layout_of(fields, volume.type, limits);
  source.frames = axes.frames;
  source.run = axes.run;
  const std::string* line_skip = fields.find("lineskip");
  const std::int64_t lines = line_skip ? header_integer(*line_skip) : 0;
  if (lines < 0) fail_malformed("The NRRD header's line skip is not possible; correct the header.");
  const auto from = [&](const std::filesystem::path& file, std::size_t offset) {
    SampleSource of = source;
    of.files = {file};
    of.offset = offset_behind_lines(file, offset, lines, limits);
    return of;
  };
  const std::string* data = fields.find("datafile");
  if (!data) return from(header, fields.end);
  const auto word = words(*data);
  const bool numbered = data->find('%') != std::string::npos && word.size() >= 4;
  if (!data->starts_with("LIST") && !numbered) {
    const auto fits = [&](const std::filesystem::path& file) { return holds_exactly(volume, from(file, 0), context); };
    return from(data_file(*data, header, files, fits, volume.warnings), 0);
  }
  if (!numbered && fields.list.empty())
    fail_malformed("The NRRD header's list of data files is empty; correct the header.");
  source.files =
      named_files(numbered ? numbered_names(word[0], std::span(word).subspan(1, 3), files.size()) : fields.list, files);
  if (lines > 0 && source.files.size() > 1) fail_unusable("Line skips are read for one data file only; save anew.");
  source.offset = offset_behind_lines(source.files[0], 0, lines, limits);
  return source;
}

}  // namespace

bool is_nrrd(std::string_view head) {
  return head.size() > 8 && head.starts_with("NRRD000") && head[7] >= '1' && head[7] <= '5' &&
         (head[8] == '\n' || head[8] == '\r');
}

bool is_detached_nrrd(std::string_view head) {
  try {
    if (!is_nrrd(head)) return false;
    const Fields fields = parse_fields(head, head.size());
    return fields.find("datafile") != nullptr;
  } catch (const Error&) {
    return false;
  }
}

Volume read_nrrd(const std::filesystem::path& header, const std::vector<std::filesystem::path>& files,
                 const ReadOptions& options, const Context& context) {
  const std::string text = read_text(header, Packing::none, options.limits.max_header_bytes);
  const Fields fields = parse_fields(text, files.size());
  if (!fields.attached && text.size() == options.limits.max_header_bytes) {
    throw Error(ErrorCode::too_large, "The NRRD header is longer than allowed; remove what the volume does not need.");
  }
  if (!fields.attached && !fields.find("datafile")) {
    fail_malformed("The NRRD header ends without an empty line or a data file; send the whole file.");
  }
  const Axes axes = axes_of(fields);

  const std::string type = lowered(fields.at("type"));
  if (type.find_first_not_of("abcdefghijklmnopqrstuvwxyz0123456789_ ") != std::string::npos) {
    fail_malformed("The NRRD header's type is unknown; correct the header.");
  }
  std::string clean = "NRRD0004\ntype: " + type + "\ndimension: 3\nsizes:";
  std::array<std::int64_t, 3> dims{1, 1, 1};
  for (std::size_t n = 0; n < axes.space.size(); ++n) dims[n] = axes.all[axes.space[n]].size;
  // Limits for the smallest type first: ITK narrows sizes without a word.
  checked_dims(dims, VoxelType::uint8, options.limits);
  for (const std::int64_t n : dims) (clean += ' ') += std::to_string(n);
  Volume volume;
  const Space space = space_of(fields, volume.warnings);
  clean += "\nencoding: raw\nendian: little\n";
  clean += fields.find("spacedirections") ? directions_of(fields, axes, space) : spacings_of(fields, axes);
  const ItkHeader parsed = parse_with_itk(ItkFormat::nrrd, clean + "\n");

  volume.format = "nrrd";
  volume.type = parsed.type;
  Vec3 scale = units_of(fields, axes, volume.warnings);
  for (int r = 0; r < 3; ++r) scale[r] *= space.signs[r];
  Mat3 lps = parsed.axes;
  for (std::size_t r = 0; r < 3; ++r) lps.rows[r] = scale[static_cast<int>(r)] * lps.rows[r] + Vec3{};
  volume.grid =
      grid_from_affine(checked_dims(parsed.dims, volume.type, options.limits), lps,
                       Vec3{scale.x * parsed.origin.x, scale.y * parsed.origin.y, scale.z * parsed.origin.z} + Vec3{});
  SampleSource source = source_of(fields, header, files, axes, volume, options.limits, context);
  source.frame = chosen_frame(axes.frames, options);
  read_samples(volume, source, context);
  return volume;
}

}  // namespace spherule
