// SPDX-License-Identifier: GPL-3.0-or-later
#include "clients/cli/options.h"

#include <getopt.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <string_view>
#include <thread>

#include "core/base/error.h"

namespace spherule::cli {

const char* const usage =
    R"(spherule COMMAND FILE... [options]: run stages of Spherule on a file, without the server

Commands
  info      what the volume is: size, spacing, type, range of values
  points    boundary points (-o writes them as spheres of radius 0)
  model     the sphere model, stage by stage (-o writes its spheres)
  simplify  a simpler model, and how near it is to the object (-o writes its spheres)
  register  the transform that lays FILE on the fixed file, and how good it is (-o transform.tfm, for ITK and 3D Slicer)
  measures  volume, area, moments and topology of each representation; thickness, components, enclosing sphere
  checks    the model's own guarantees, with counts of violations
  render    a picture of the spheres (-o picture.png)
  export    the spheres as a file (-o FILE, see Files)

FILE is a volume (NIfTI, NRRD, MetaImage, OpenVDB, raw; a header's data may lie beside it), or for model, simplify,
measures, render and export a set of spheres (.csv or .npy with x y z r in mm).

The object
  --threshold T          inside where value >= T
  --range LO,HI          inside where LO <= value <= HI
  --labels A,B,...       inside where the value is one of these whole numbers
  --below, --above       which side is inside (default: above; level sets: below)
  --border closed|open   at the border of the volume (default: closed, half a voxel beyond it)

Reading
  --raw NX,NY,NZ,TYPE[,SX,SY,SZ[,OX,OY,OZ]][,big]   headerless samples, x fastest; TYPE by NumPy's names
  --frame N              of a file of several volumes
  --grid NAME            of an OpenVDB file

Simplification
  --method sphericity[,threshold=T][,limit=N][,representative=R]    clusters at least so round, at most N
  --method median|average[,k=N][,representative=R]                  N clusters, by splitting the widest one
  --method prune,least_radius_mm=R                                  spheres of at least this radius
  --method prune,buckets=B,...[,bucket_count=N]                     spheres in these buckets of the radii
  --method prune,volume_share=S | prune,k=N                         spheres with the largest parts of the volume
  --method best,k=N | best,iou=S[,mode=inner|best|outer]            the N spheres that overlap best, or enough of them
R is enclosing, largest, mean or volume.

Registration
  --fixed FILE           what FILE is laid on; again for each file of it
  --transform T          rigid, similarity or affine (default: similarity)

Files of spheres, by the ending of -o
  .csv .npy .ply .vtp                    tables
  .urdf .srdf .xrdf .yml                 robots' collision spheres (.yml: cuRobo)
  .multisphere .molecule .clump.txt      clumps for LIGGGHTS, LAMMPS, YADE
  .xyz .pqr .glb                         viewers
  .vdb .nii.gz                           OpenVDB level set, mask on the grid of the scan
  --file NAME=VALUE[,NAME=VALUE...]      of all but tables: density=KG_M3, link=NAME, origin=frame|centre,
                                         style=instanced|mesh, detail=0..5, voxel_mm=D, where the format has them

Pictures
  --view a|p|r|l|h|f     seen from the front, back, right, left, above (head), below (feet) (default: a)
  --size W[xH]           pixels (default: 800)
  --samples N            N x N rays a pixel (default: 3)
  --background transparent|white|dark

Other
  -o, --output FILE      what to write
  --threads N            (default: as many as the machine has)
  --plain                "key value" lines for scripts, the unit at the end of the key
  --help

Exit status: 0 done, 1 the data cannot be used, 2 the command line makes no sense.
)";

namespace {

constexpr std::array kCommands{"info",     "points", "model",  "simplify", "register",
                               "measures", "checks", "render", "export"};

template <typename T>
T number(std::string_view text, std::string_view option) {
  T value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || error != std::errc{} || end != text.data() + text.size())
    throw UsageError(std::string(option) + " expects a number, not \"" + std::string(text) + "\".");
  return value;
}

std::vector<std::string_view> split(std::string_view text, char separator) {
  std::vector<std::string_view> parts;
  for (;;) {
    const auto end = text.find(separator);
    parts.push_back(text.substr(0, end));
    if (end == std::string_view::npos) return parts;
    text.remove_prefix(end + 1);
  }
}

RawLayout parse_raw(std::string_view text) {
  auto parts = split(text, ',');
  RawLayout raw;
  if (parts.back() == "big") {
    raw.big_endian = true;
    parts.pop_back();
  }
  if (parts.size() != 4 && parts.size() != 7 && parts.size() != 10)
    throw UsageError("--raw expects NX,NY,NZ,TYPE, then a spacing of three numbers and an origin of three, if given.");
  const auto vector_at = [&](std::size_t first) {
    return Vec3{number<double>(parts[first], "--raw"), number<double>(parts[first + 1], "--raw"),
                number<double>(parts[first + 2], "--raw")};
  };
  for (std::size_t a = 0; a < 3; ++a) raw.dims[a] = number<std::int32_t>(parts[a], "--raw");
  raw.type = voxel_type(parts[3]);
  if (parts.size() >= 7) raw.spacing = vector_at(4);
  if (parts.size() >= 10) raw.origin = vector_at(7);
  return raw;
}

ObjectRule parse_rule(ObjectRule::Kind kind, std::string_view text) {
  ObjectRule rule;
  rule.kind = kind;
  const auto parts = split(text, ',');
  switch (kind) {
    case ObjectRule::Kind::threshold: rule.lo = number<double>(text, "--threshold"); break;
    case ObjectRule::Kind::range:
      if (parts.size() != 2) throw UsageError("--range expects two numbers, LO,HI.");
      rule.lo = number<double>(parts[0], "--range");
      rule.hi = number<double>(parts[1], "--range");
      if (!std::isfinite(rule.hi) || !(rule.lo <= rule.hi))
        throw UsageError("--range expects two finite numbers, the smaller one first.");
      break;
    case ObjectRule::Kind::labels:
      for (const auto part : parts) {
        const std::optional<Label> label = parse_label(part);
        if (!label) throw UsageError("--labels expects whole numbers with commas between.");
        rule.labels.push_back(*label);
      }
      std::ranges::sort(rule.labels);
      rule.labels.erase(std::unique(rule.labels.begin(), rule.labels.end()), rule.labels.end());
      break;
  }
  if (!std::isfinite(rule.lo)) throw UsageError("--threshold and --range expect finite numbers.");
  return rule;
}

// "best,k=64": what has no name goes on with the value before it.
OptionTexts method_words(std::string_view text) {
  OptionTexts words;
  for (const std::string_view part : split(text, ',')) {
    const std::size_t equals = part.find('=');
    if (words.empty()) {
      words.emplace_back("method", part);
    } else if (equals != part.npos) {
      words.emplace_back(part.substr(0, equals), part.substr(equals + 1));
    } else {
      words.back().second += "," + std::string(part);
    }
  }
  return words;
}

// The value of a table of names, or a UsageError that lists them.
template <typename T, std::size_t N>
T one_of(const std::array<std::pair<const char*, T>, N>& table, std::string_view text, std::string_view option) {
  std::string names;
  for (const auto& [name, value] : table) {
    if (text == name) return value;
    names += (names.empty() ? "" : ", ") + std::string(name);
  }
  throw UsageError(std::string(option) + " is one of " + names + ", not \"" + std::string(text) + "\".");
}

}  // namespace

Options parse(int argc, char** argv) {
  enum Long {
    threshold = 256,
    range,
    labels,
    below,
    above,
    border,
    raw,
    frame,
    grid,
    method,
    file,
    view,
    size,
    samples,
    background,
    fixed,
    transform,
    threads,
    plain,
    help
  };
  static const option kLong[] = {{"threshold", required_argument, nullptr, threshold},
                                 {"range", required_argument, nullptr, range},
                                 {"labels", required_argument, nullptr, labels},
                                 {"below", no_argument, nullptr, below},
                                 {"above", no_argument, nullptr, above},
                                 {"border", required_argument, nullptr, border},
                                 {"raw", required_argument, nullptr, raw},
                                 {"frame", required_argument, nullptr, frame},
                                 {"grid", required_argument, nullptr, grid},
                                 {"method", required_argument, nullptr, method},
                                 {"file", required_argument, nullptr, file},
                                 {"fixed", required_argument, nullptr, fixed},
                                 {"transform", required_argument, nullptr, transform},
                                 {"view", required_argument, nullptr, view},
                                 {"size", required_argument, nullptr, size},
                                 {"samples", required_argument, nullptr, samples},
                                 {"background", required_argument, nullptr, background},
                                 {"output", required_argument, nullptr, 'o'},
                                 {"threads", required_argument, nullptr, threads},
                                 {"plain", no_argument, nullptr, plain},
                                 {"help", no_argument, nullptr, help},
                                 {nullptr, 0, nullptr, 0}};
  Options options;
  options.threads = std::max(1U, std::thread::hardware_concurrency());
  Border rule_border = Border::closed;
  const auto set_rule = [&](ObjectRule::Kind kind) {
    if (options.rule) throw UsageError("Give one of --threshold, --range and --labels, once.");
    options.rule = parse_rule(kind, optarg);
  };
  opterr = 0;
  for (int c; (c = getopt_long(argc, argv, ":o:", kLong, nullptr)) != -1;) {
    switch (c) {
      case threshold: set_rule(ObjectRule::Kind::threshold); break;
      case range: set_rule(ObjectRule::Kind::range); break;
      case labels: set_rule(ObjectRule::Kind::labels); break;
      case below: options.side = Side::below; break;
      case above: options.side = Side::above; break;
      case border:
        rule_border = one_of(std::array{std::pair{"closed", Border::closed}, std::pair{"open", Border::open}}, optarg,
                             "--border");
        break;
      case raw: options.read.raw = parse_raw(optarg); break;
      case frame: options.read.frame = number<int>(optarg, "--frame"); break;
      case grid: options.read.grid = optarg; break;
      case method: options.method = parse_method(method_words(optarg)); break;
      case file:
        for (const std::string_view part : split(optarg, ',')) {
          const std::size_t equals = part.find('=');
          if (equals == part.npos) throw UsageError("--file expects NAME=VALUE, then others after commas.");
          options.file.emplace_back(part.substr(0, equals), part.substr(equals + 1));
        }
        break;
      case fixed: options.fixed.emplace_back(optarg); break;
      case transform:
        options.transform = one_of(
            std::array{std::pair{"rigid", TransformKind::rigid}, std::pair{"similarity", TransformKind::similarity},
                       std::pair{"affine", TransformKind::affine}},
            optarg, "--transform");
        break;
      case view:
        options.render.views.front() = one_of(
            std::array{std::pair{"a", View::anterior}, std::pair{"p", View::posterior}, std::pair{"r", View::right},
                       std::pair{"l", View::left}, std::pair{"h", View::head}, std::pair{"f", View::foot}},
            optarg, "--view");
        break;
      case size: {
        const auto parts = split(optarg, 'x');
        if (parts.size() > 2) throw UsageError("--size expects W or WxH, in pixels.");
        options.render.width = number<int>(parts.front(), "--size");
        options.render.height = number<int>(parts.back(), "--size");
        break;
      }
      case samples: options.render.samples_per_axis = number<int>(optarg, "--samples"); break;
      case background:
        options.render.background =
            one_of(std::array{std::pair{"transparent", Background::transparent}, std::pair{"white", Background::white},
                              std::pair{"dark", Background::dark}},
                   optarg, "--background");
        break;
      case 'o': options.out = optarg; break;
      case threads: options.threads = number<unsigned>(optarg, "--threads"); break;
      case plain: options.plain = true; break;
      case help: options.help = true; return options;
      case ':': throw UsageError(std::string(argv[optind - 1]) + " needs a value.");
      default: throw UsageError("There is no option " + std::string(argv[optind - 1]) + "; see spherule --help.");
    }
  }
  if (options.rule) options.rule->border = rule_border;
  if (options.threads < 1 || options.threads > 1024) throw UsageError("--threads is within 1 and 1024.");
  if (optind >= argc) throw UsageError("Say what to do: spherule COMMAND FILE...; see spherule --help.");
  options.command = argv[optind++];
  if (std::ranges::find(kCommands, options.command) == kCommands.end())
    throw UsageError("There is no command \"" + options.command + "\"; see spherule --help.");
  options.files.assign(argv + optind, argv + argc);
  if (options.files.empty()) throw UsageError("Name a file: spherule " + options.command + " FILE....");
  return options;
}

}  // namespace spherule::cli
