// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/io/nrrd.h"

#include <algorithm>
#include <map>
#include <set>

#include "core/io/itk.h"
#include "core/io/read_bytes.h"
#include "core/io/read_header.h"

namespace spherule {

namespace {

[[noreturn]] void fail_malformed(const std::string& sentence) { throw Error(ErrorCode::malformed, sentence); }
[[noreturn]] void fail_unusable(const std::string& sentence) { throw Error(ErrorCode::unusable, sentence); }

struct Fields {
  std::map<std::string, std::string> value;  // by name: lower case, without blanks
  std::vector<std::string> list;             // of data files
  std::size_t end = 0;                       // of the header: where attached data start
  bool attached = false;

  const std::string* find(const std::string& name) const {
    const auto found = value.find(name);
    return found == value.end() ? nullptr : &found->second;
  }
  const std::string& at(const std::string& name) const {
    if (const std::string* found = find(name)) return *found;
    fail_malformed("The NRRD header lacks its type, dimension, sizes, encoding or byte order; correct the header.");
  }
};

std::string lowered(std::string_view text) {
  std::string result(text);
  for (char& c : result) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  return result;
}

Fields parse_fields(std::string_view text) {
  static const std::map<std::string, std::string> synonyms{{"centers", "centerings"}};
  Fields fields;
  std::string_view rest = text;
  next_line(rest);  // the magic
  while (!rest.empty()) {
    const std::string_view line = next_line(rest);
    if (line.empty()) {
      fields.attached = true;
      break;
    }
    const std::size_t colon = line.find(':');
    if (line[0] == '#' || line.find(":=") == colon) {
      if (line[0] == '#' || colon != std::string_view::npos) continue;
      fail_malformed("The NRRD header has a line that is neither a field nor a comment; correct the header.");
    }
    std::string name = lowered(line.substr(0, colon));
    std::erase(name, ' ');
    if (const auto synonym = synonyms.find(name); synonym != synonyms.end()) name = synonym->second;
    const std::string_view value = trimmed(line.substr(colon + 1));
    if (!fields.value.emplace(name, value).second) {
      fail_malformed("The NRRD header says the same field twice; correct the header.");
    }
    if (name == "datafile" && value.starts_with("LIST")) {
      while (!rest.empty()) {
        if (const std::string_view file = trimmed(next_line(rest)); !file.empty()) fields.list.emplace_back(file);
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

std::string bracketed(const std::vector<double>& v) {
  std::string text = "(";
  text += joined(v);
  text += ")";
  std::ranges::replace(text, ' ', ',');
  return text;
}

// Which axes are of space (always the fastest ones), and how many volumes the slower axis holds.
struct Axes {
  std::vector<std::int64_t> sizes;
  std::size_t space = 0;
  std::int64_t frames = 1;
};

Axes axes_of(const Fields& fields) {
  const std::int64_t dimension = header_integer(fields.at("dimension"));
  if (dimension < 1 || dimension > 16)
    fail_malformed("The NRRD header's dimension must be within 1 and 16; correct it.");
  Axes axes;
  axes.sizes = header_integers(fields.at("sizes"), static_cast<std::size_t>(dimension));
  if (std::ranges::any_of(axes.sizes, [](std::int64_t n) { return n < 1; })) {
    fail_unusable("Every size in the NRRD header must be at least 1; correct the header.");
  }
  const std::size_t rank = axes.sizes.size();
  std::vector<bool> in_space(rank, true);
  bool told = false;
  if (const std::string* kinds = fields.find("kinds")) {
    const auto kind = words(*kinds);
    if (kind.size() != rank) fail_malformed("The NRRD header needs one kind an axis; correct the header.");
    for (std::size_t a = 0; a < rank; ++a) {
      const std::string k = lowered(kind[a]);
      if (k == "???" || k == "none") continue;
      told = true;
      in_space[a] = k == "domain" || k == "space";
    }
  }
  if (const std::string* directions = fields.find("spacedirections")) {
    const auto direction = vectors(*directions);
    if (direction.size() != rank)
      fail_malformed("The NRRD header needs one space direction an axis; correct the header.");
    for (std::size_t a = 0; a < rank; ++a) in_space[a] = in_space[a] && !direction[a].empty();
    told = true;
  }
  for (const char* name : {"spacings", "axismins", "thicknesses"}) told = told || fields.find(name);
  if (!told && rank == 3 && (axes.sizes[0] == 3 || axes.sizes[0] == 4)) {
    fail_unusable(
        "The file looks like a colour picture (3 or 4 samples along its fastest axis, and nothing says that this is an "
        "axis of space); if it is a volume, add spacings to the header.");
  }
  if (rank == 4 && std::ranges::all_of(in_space, [](bool b) { return b; })) in_space[3] = false;
  axes.space = static_cast<std::size_t>(std::ranges::find(in_space, false) - in_space.begin());
  for (std::size_t a = axes.space; a < rank; ++a) {
    if (in_space[a] || (axes.frames > 1 && axes.sizes[a] > 1)) {
      fail_unusable(
          "The file holds colours, vectors or too many dimensions, not one scalar a voxel; split it into one volume "
          "each.");
    }
    axes.frames *= axes.sizes[a];
  }
  if (axes.space != 2 && axes.space != 3) fail_unusable("The file must have two or three axes of space; reshape it.");
  return axes;
}

// The per-axis numbers of a field for the axes of space, with `flat` for the third of a flat picture.
std::vector<double> per_axis(const std::string& text, const Axes& axes, double flat) {
  const auto word = words(text);
  if (word.size() != axes.sizes.size()) fail_malformed("The NRRD header needs one number an axis; correct the header.");
  std::vector<double> values;
  for (std::size_t a = 0; a < axes.space; ++a) values.push_back(header_number(word[a]));
  values.resize(3, flat);
  return values;
}

std::string three(const std::vector<double>& v, double last) {
  if (v.size() != 2 && v.size() != 3) fail_unusable("The NRRD header's space must be of three dimensions; correct it.");
  std::vector<double> padded = v;
  padded.resize(3, last);
  return bracketed(padded);
}

std::string geometry(const Fields& fields, const Axes& axes) {
  std::string text;
  if (const std::string* directions = fields.find("spacedirections")) {
    if (fields.find("spacings")) {
      fail_malformed("The NRRD header says both spacings and space directions; keep one of them.");
    }
    std::vector<std::vector<double>> steps = vectors(*directions);
    steps.resize(axes.space);
    if (axes.space == 2) {
      const auto vec = [](const std::vector<double>& v) { return Vec3{v[0], v[1], v.size() > 2 ? v[2] : 0}; };
      if (steps[0].size() < 2 || steps[1].size() < 2)
        fail_unusable("The NRRD header's space is too small; correct it.");
      const Vec3 normal = cross(vec(steps[0]), vec(steps[1]));
      const double length = norm(normal);
      if (!(length > 0)) fail_unusable("The NRRD header's space directions are singular; correct the header.");
      steps.push_back({normal.x / length, normal.y / length, normal.z / length});
    }
    // Always LPS here: the frame is changed by us, because ITK 5.2 mirrors the wrong axis of left-anterior-superior.
    text += "space: left-posterior-superior\nspace directions:";
    for (const auto& step : steps) (text += ' ') += three(step, 0);
    text += "\n";
    if (const std::string* origin = fields.find("spaceorigin")) {
      const auto values = vectors(*origin);
      if (values.size() != 1) fail_malformed("The NRRD header's space origin must be one vector; correct the header.");
      text += "space origin: " + three(values[0], 0) + "\n";
    }
    return text;
  }
  // The space is left out here: ITK refuses it beside spacings, though NRRD allows both.
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
      if (word.size() != axes.sizes.size()) fail_malformed("The NRRD header needs one centering an axis; correct it.");
      text += "centerings:";
      for (std::size_t a = 0; a < 3; ++a) {
        const std::string w = a < axes.space ? lowered(word[a]) : std::string("cell");
        text += w == "node" ? " node" : w == "cell" ? " cell" : " ???";
      }
      text += "\n";
    }
  }
  return text;
}

// From the header's frame to LPS.
Vec3 frame_signs(const Fields& fields, std::vector<std::string>& warnings) {
  const std::string* field = fields.find("space");
  const std::string space = field ? lowered(*field) : "";
  if (space == "left-posterior-superior" || space == "lps") return {1, 1, 1};
  if (space == "right-anterior-superior" || space == "ras") return {-1, -1, 1};
  if (space == "left-anterior-superior" || space == "las") return {1, -1, 1};
  if (space.ends_with("-time") || space == "rast" || space == "last" || space == "lpst") {
    fail_unusable("The NRRD header's space includes time; write each volume by itself.");
  }
  warnings.push_back(
      "The NRRD header does not say how the volume lies in the patient; its axes were taken as left, posterior, "
      "superior.");
  return {1, 1, 1};
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

SampleSource source_of(const Fields& fields, const std::filesystem::path& header,
                       const std::vector<std::filesystem::path>& files, VoxelType type, const ReadLimits& limits) {
  SampleSource source;
  const std::string encoding = lowered(fields.at("encoding"));
  if (encoding == "gzip" || encoding == "gz") {
    source.packing = Packing::deflate;
  } else if (encoding != "raw") {
    fail_unusable("Only the NRRD encodings raw and gzip are read; save the file with one of them.");
  }
  if (bytes_per_voxel(type) > 1) {
    const std::string endian = lowered(fields.at("endian"));
    if (endian != "little" && endian != "big") fail_malformed("The NRRD header's endian must be little or big.");
    source.big_endian = endian == "big";
  }
  if (const std::string* data = fields.find("datafile")) {
    std::vector<std::string> names = fields.list;
    const auto word = words(*data);
    if (data->starts_with("LIST")) {
      if (names.empty()) fail_malformed("The NRRD header's list of data files is empty; correct the header.");
    } else if (data->find('%') != std::string::npos && word.size() >= 4) {
      names = numbered_names(word[0], std::span(word).subspan(1, 3), files.size());
    } else {
      names = {*data};
    }
    source.files = named_files(names, files);
  } else {
    source.files = {header};
    source.offset = fields.end;
  }
  const std::string* line_skip = fields.find("lineskip");
  const std::string* byte_skip = fields.find("byteskip");
  const std::int64_t lines = line_skip ? header_integer(*line_skip) : 0;
  const std::int64_t bytes = byte_skip ? header_integer(*byte_skip) : 0;
  if (lines < 0 || bytes < -1 || (bytes == -1 && source.packing != Packing::none)) {
    fail_malformed("The NRRD header's line skip or byte skip is not possible; correct the header.");
  }
  if (lines > 0 && source.files.size() > 1) fail_unusable("Line skips are read for one data file only; save anew.");
  source.offset = offset_behind_lines(source.files[0], source.offset, lines, limits);
  source.at_end = bytes == -1;
  source.skip = static_cast<std::uint64_t>(std::max<std::int64_t>(bytes, 0));
  if (source.skip > limits.max_bytes)
    fail_malformed("The NRRD header's byte skip is not possible; correct the header.");
  return source;
}

}  // namespace

bool is_nrrd(std::string_view head) {
  return head.size() > 8 && head.starts_with("NRRD000") && head[7] >= '1' && head[7] <= '5' &&
         (head[8] == '\n' || head[8] == '\r');
}

Volume read_nrrd(const std::filesystem::path& header, const std::vector<std::filesystem::path>& files,
                 const ReadOptions& options, const Context& context) {
  const std::string text = read_text(header, Packing::none, options.limits.max_header_bytes);
  const Fields fields = parse_fields(text);
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
  std::copy_n(axes.sizes.begin(), axes.space, dims.begin());
  // Limits for the smallest type first: ITK narrows sizes without a word.
  checked_dims(dims, VoxelType::uint8, options.limits);
  for (const std::int64_t n : dims) (clean += ' ') += std::to_string(n);
  clean += "\nencoding: raw\nendian: little\n" + geometry(fields, axes) + "\n";
  const ItkHeader parsed = parse_with_itk(ItkFormat::nrrd, clean);

  Volume volume;
  volume.format = "nrrd";
  volume.type = parsed.type;
  const Vec3 sign = frame_signs(fields, volume.warnings);
  Mat3 lps = parsed.axes;
  for (std::size_t r = 0; r < 3; ++r) lps.rows[r] = sign[static_cast<int>(r)] * lps.rows[r] + Vec3{};
  volume.grid =
      grid_from_affine(checked_dims(parsed.dims, volume.type, options.limits), lps,
                       Vec3{sign.x * parsed.origin.x, sign.y * parsed.origin.y, sign.z * parsed.origin.z} + Vec3{});
  SampleSource source = source_of(fields, header, files, volume.type, options.limits);
  source.frames = axes.frames;
  source.frame = chosen_frame(axes.frames, options);
  read_samples(volume, source, context);
  return volume;
}

}  // namespace spherule
