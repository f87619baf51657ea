// SPDX-License-Identifier: GPL-3.0-or-later
#include "clients/cli/options.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <string_view>
#include <thread>

#include "core/base/text.h"
#include "core/render/options.h"

namespace spherule::cli {
namespace {

template <typename T>
T number(std::string_view text, const char* option) {
  const auto value = number_in<T>(text);
  if (!value) throw UsageError(std::string(option) + " expects a number, not \"" + std::string(text) + "\".");
  return *value;
}

// The enumerator with the number of the word.
template <typename T, std::size_t N>
T one_of(const std::array<std::string_view, N>& words, std::string_view text, const char* option) {
  const auto found = std::ranges::find(words, text);
  if (found == words.end())
    throw UsageError(std::string(option) + " is one of " + listed(words) + ", not \"" + std::string(text) + "\".");
  return static_cast<T>(found - words.begin());
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
      if (!(rule.lo <= rule.hi)) throw UsageError("--range expects two numbers, the smaller one first.");
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

void add_file_words(std::string_view text, OptionTexts& words) {
  for (const std::string_view part : split(text, ',')) {
    const std::size_t equals = part.find('=');
    if (equals == part.npos) throw UsageError("--file expects NAME=VALUE, then others after commas.");
    words.emplace_back(part.substr(0, equals), part.substr(equals + 1));
  }
}

// A command line as it is read: what is settled only once all of it is known.
struct Reading {
  Options options;
  Border border = Border::closed;
  OptionTexts picture;
};

// Options in one group of a command's help.
class Group {
 public:
  Group(CLI::App& command, const char* title) : command_(command), title_(title) {}

  void value(const std::string& names, const char* value, const char* what,
             const std::function<void(const std::string&)>& read) {
    command_.add_option_function<std::string>(names, read, what)->type_name(value)->group(title_);
  }
  // Given as often as one likes, with one value each time.
  void values(const std::string& names, const char* value, const char* what,
              const std::function<void(const std::vector<std::string>&)>& read) {
    CLI::Option* option = command_.add_option_function<std::vector<std::string>>(names, read, what);
    option->type_name(value)->group(title_);
    option->allow_extra_args(false);
  }
  void flag(const std::string& name, const char* what, const std::function<void()>& set) {
    command_.add_flag_callback(name, set, what)->group(title_);
  }

 private:
  CLI::App& command_;
  const char* title_;
};

void add_object(CLI::App& command, Reading& r) {
  Group group(command, "The object");
  const auto rule = [&](const char* names, const char* value, const char* what, ObjectRule::Kind kind) {
    group.value(names, value, what, [&r, kind](const std::string& text) {
      if (r.options.rule) throw UsageError("Give one of --threshold, --range and --labels, once.");
      r.options.rule = parse_rule(kind, text);
    });
  };
  rule("--threshold", "T", "inside where value >= T", ObjectRule::Kind::threshold);
  rule("--range", "LO,HI", "inside where LO <= value <= HI", ObjectRule::Kind::range);
  rule("--labels", "A,B,...", "inside where the value is one of these whole numbers", ObjectRule::Kind::labels);
  group.flag("--below", "inside is below the threshold (default of level sets)",
             [&r] { r.options.side = Side::below; });
  group.flag("--above", "inside is above it (default of all others)", [&r] { r.options.side = Side::above; });
  group.value("--border", "closed|open", "at the border of the volume (default: closed, half a voxel beyond it)",
              [&r](const std::string& text) {
                r.border = one_of<Border>(std::to_array<std::string_view>({"closed", "open"}), text, "--border");
              });
}

void add_volume(CLI::App& command, Reading& r) {
  Group group(command, "The volume");
  group.value("--raw", "NX,NY,NZ,TYPE[,SX,SY,SZ[,OX,OY,OZ]][,big]",
              "headerless samples, x fastest; TYPE by NumPy's names",
              [&r](const std::string& text) { r.options.read.raw = parse_raw(text); });
  group.value("--frame", "N", "of a file of several volumes",
              [&r](const std::string& text) { r.options.read.frame = number<int>(text, "--frame"); });
  group.value("--grid", "NAME", "of an OpenVDB file", [&r](const std::string& text) { r.options.read.grid = text; });
}

void add_output(CLI::App& command, const char* what, Reading& r) {
  Group(command, "Output").value("-o,--output", "FILE", what, [&r](const std::string& text) { r.options.out = text; });
}

// Below the options in the command's help.
void explain(CLI::App& command, const char* text) {
  const std::string before = command.get_footer();
  command.footer(before.empty() ? text : before + "\n\n" + text);
}

void add_sphere_file(CLI::App& command, const char* what, Reading& r) {
  add_output(command, what, r);
  Group(command, "Output")
      .values("--file", "NAME=VALUE,...",
              "what the file's format has of density=KG_M3, link=NAME, origin=frame|centre,\n"
              "style=instanced|mesh, detail=0..5, voxel_mm=D",
              [&r](const std::vector<std::string>& texts) {
                for (const std::string& text : texts) add_file_words(text, r.options.file);
              });
  explain(command, R"(Files of spheres, by the ending of -o
  .csv .npy .ply .vtp                    tables
  .urdf .srdf .xrdf .yml                 robots' collision spheres (.yml: cuRobo)
  .multisphere .molecule .clump.txt      clumps for LIGGGHTS, LAMMPS, YADE
  .xyz .pqr .glb                         viewers
  .vdb .nii.gz                           OpenVDB level set, mask on the grid of the scan)");
}

void add_method(CLI::App& command, Reading& r) {
  Group(command, "Simplification").value("--method", "NAME,...", "see Methods", [&r](const std::string& text) {
    r.options.method = parse_method(method_words(text));
  });
  explain(command, R"(Methods
  --method sphericity[,threshold=T][,limit=N][,representative=R]    clusters at least so round, at most N
  --method median|average[,k=N][,representative=R]                  N clusters, by splitting the widest one
  --method prune,least_radius_mm=R                                  spheres of at least this radius
  --method prune,buckets=B,...[,bucket_count=N]                     spheres in these buckets of the radii
  --method prune,volume_share=S | prune,k=N                         spheres with the largest parts of the volume
  --method best,k=N | best,iou=S[,mode=inner|best|outer]            the N spheres that overlap best, or enough of them
R is enclosing, largest, mean or volume.)");
}

void add_registration(CLI::App& command, Reading& r) {
  Group group(command, "Registration");
  group.values("--fixed", "FILE", "what FILE is laid on; again for each file of it",
               [&r](const std::vector<std::string>& files) { r.options.fixed.assign(files.begin(), files.end()); });
  group.value("--transform", "T", "rigid, similarity or affine (default: similarity)", [&r](const std::string& text) {
    constexpr auto kWords = std::to_array<std::string_view>({"rigid", "similarity", "affine"});
    r.options.transform = one_of<TransformKind>(kWords, text, "--transform");
  });
}

struct PictureHelp {
  std::string_view name;
  const char *value, *what;
};
// Of what core/render/options.h names.
constexpr auto kPictureHelp = std::to_array<PictureHelp>({
    {"style", "NAME", "spheres, blobs, tetrahedra, surface, points or centres"},
    {"smoothness", "S", "of blobs: over how many median radii they blend (default: 0.5)"},
    {"point_radius", "MM", "of points and centres (default: one that suits the model)"},
    {"min_radius", "MM", "smaller spheres are left out"},
    {"max_radius", "MM", "larger ones are left out"},
    {"buckets", "0,3-5,...", "only spheres in these buckets of the radii, counted from 0"},
    {"bucket_count", "N", "of those buckets (default: 40)"},
    {"width", "N", "pixels of a view (default: 800)"},
    {"height", "N", "pixels (default: 800)"},
    {"samples", "N", "N x N rays a pixel at edges (default: 3)"},
    {"background", "NAME", "transparent, white, dark or gradient (default: transparent)"},
    {"view", "a|p|r|l|h|f", "from the front, back, right, left, above (head), below (feet) (default: a)"},
    {"views", "a,r,h,...", "several, side by side and to one scale"},
    {"position", "X,Y,Z", "where the camera stands instead, LPS mm"},
    {"look_at", "X,Y,Z", "what is in the middle of the picture (default: the middle of the object)"},
    {"up", "X,Y,Z", "the direction that is up in the picture (default: the head)"},
    {"fit", "true|false", "keep only the direction of the camera, and fit the object (default: false)"},
    {"projection", "NAME", "orthographic or perspective (default: orthographic)"},
    {"field_of_view", "DEG", "across the shorter side (default: 25)"},
    {"clip", "X,Y,Z[,D]", "keep what has (X,Y,Z) . point <= D (default: up to the middle)"},
    {"turntable", "N", "frames of one turn, as a GIF (-o FILE.gif)"},
    {"shadows", "true|false", "of the key light (default: true)"},
    {"ambient_occlusion", "true|false", "shadows of the sky (default: true)"},
    {"opacity", "S", "of the surface (default: 1)"},
    {"colour_by", "NAME", "none, radius, contribution, component, cluster or curvature"},
    {"colour_map", "NAME", "ember, lagoon, grey or tide (default: ember; curvature: tide)"},
    {"colour_range", "LO,HI", "the numbers at its ends (default: of the middle 98 %)"},
    {"legend", "true|false", "where colours are numbers (default: true)"},
    {"marker", "true|false", "the patient's axes (default: false)"},
    {"scale_bar", "true|false", "(default: false)"},
});

void add_picture(CLI::App& command, Reading& r) {
  Group group(command, "The picture");
  for (const std::string_view name : render_option_names()) {
    if (name == "layout") continue;  // of two models
    std::string option = "--" + std::string(name);
    std::ranges::replace(option, '_', '-');
    const auto help = std::ranges::find(kPictureHelp, name, &PictureHelp::name);
    const bool told = help != kPictureHelp.end();
    group.value(option, told ? help->value : "VALUE", told ? help->what : "",
                [&r, name](const std::string& text) { r.picture.emplace_back(name, text); });
  }
  group.value("--size", "W[xH]", "width and height in one", [&r](const std::string& text) {
    const auto parts = split(text, 'x');
    if (parts.size() > 2) throw UsageError("--size expects W or WxH, in pixels.");
    r.picture.emplace_back("width", parts.front());
    r.picture.emplace_back("height", parts.back());
  });
}

void add_others(CLI::App& command, Reading& r) {
  Group group(command, "Other");
  group.value("--threads", "N", "(default: as many as the machine has)", [&r](const std::string& text) {
    r.options.threads = number<unsigned>(text, "--threads");
    if (r.options.threads < 1 || r.options.threads > 1024) throw UsageError("--threads is within 1 and 1024.");
  });
  group.flag("--plain", "\"key value\" lines for scripts, the unit at the end of the key",
             [&r] { r.options.plain = true; });
}

// A page of help whose explanations begin at a column.
class Page : public CLI::Formatter {
 public:
  explicit Page(std::size_t column) { column_width(column); }
  std::string make_usage(const CLI::App* app, std::string) const override {
    return "\nUsage: spherule " + (app->get_parent() != nullptr ? app->get_name() : "COMMAND") + " FILE... [options]\n";
  }
  std::string make_help(const CLI::App* app, std::string name, CLI::AppFormatMode mode) const override {
    std::string text = Formatter::make_help(app, std::move(name), mode);
    for (std::size_t at; (at = text.find("\n\n\n")) != text.npos;) text.erase(at, 1);
    return text;
  }
};

CLI::App* add_command(CLI::App& app, const char* name, const char* what, Reading& r) {
  CLI::App* command = app.add_subcommand(name, what)->group("Commands")->allow_extras();
  command->formatter(std::make_shared<Page>(25));
  command->get_help_ptr()->group("");
  command
      ->add_option_function<std::vector<std::string>>(
          "FILE", [&r](const std::vector<std::string>& files) { r.options.files.assign(files.begin(), files.end()); })
      ->group("");
  return command;
}

void add_commands(CLI::App& app, Reading& r) {
  const char* const spheres = "the spheres, see below";
  const auto command = [&](const char* name, const char* what) -> CLI::App& {
    CLI::App& made = *add_command(app, name, what, r);
    if (std::string_view(name) != "info") add_object(made, r);
    add_volume(made, r);
    return made;
  };
  command("info", "what the volume is: size, spacing, type, range of values");
  add_output(command("points", "boundary points (-o writes them as spheres of radius 0)"),
             "the points as spheres of radius 0: .csv, .npy, .ply or .vtp", r);
  add_sphere_file(command("model", "the sphere model, stage by stage (-o writes its spheres)"), spheres, r);
  CLI::App& simplify = command("simplify", "a simpler model, and how near it is to the object (-o writes its spheres)");
  add_method(simplify, r);
  add_sphere_file(simplify, spheres, r);
  CLI::App& registration = command("register", "the transform that lays FILE on the fixed file, and how good it is");
  add_registration(registration, r);
  add_output(registration, "the transform, for ITK and 3D Slicer: .tfm", r);
  command("measures",
          "volume, area, moments and topology of each representation; thickness, components, enclosing sphere");
  command("checks", "the model's own guarantees, with counts of violations");
  CLI::App& render = command("render", "a picture of the spheres (-o picture.png)");
  add_picture(render, r);
  add_output(render, "the picture: .png, or .gif of a turntable", r);
  add_sphere_file(command("export", "the spheres as a file (-o FILE)"), spheres, r);
  for (CLI::App* each : app.get_subcommands({})) add_others(*each, r);
}

// What the parser refuses, in our words: an option that is given twice, or the last one without its value.
[[noreturn]] void refuse(const CLI::App& command, const std::string& last) {
  for (const CLI::Option* option : command.get_options())
    if (option->count() > 1 && option->get_expected_max() == 1)
      throw UsageError("Give " + option->get_name() + " once.");
  throw UsageError(last + " needs a value.");
}

void check_words(const CLI::App& app, const Options& options) {
  const auto commands = app.get_subcommands();
  const auto strange = app.remaining(true);
  if (commands.empty() && strange.empty())
    throw UsageError("Say what to do: spherule COMMAND FILE...; see spherule --help.");
  if (commands.empty() && !strange.front().starts_with('-'))
    throw UsageError("There is no command \"" + strange.front() + "\"; see spherule --help.");
  if (!app.remaining().empty())
    throw UsageError("Begin with the command: spherule COMMAND FILE... [options]; see spherule --help.");
  const std::string& name = commands.front()->get_name();
  if (!strange.empty())
    throw UsageError("The command " + name + " has no option " + strange.front() + "; see spherule " + name +
                     " --help.");
  if (options.files.empty()) throw UsageError("Name a file: spherule " + name + " FILE....");
}

}  // namespace

Options parse(int argc, char** argv) {
  Reading r;
  r.options.threads = std::max(1U, std::thread::hardware_concurrency());
  CLI::App app("Runs stages of Spherule on a file, without the server.");
  app.formatter(std::make_shared<Page>(12));
  app.allow_extras()->require_subcommand(0, 1);
  add_commands(app, r);
  app.get_help_ptr()->group("");  // only now: what is hidden is not handed on to commands
  app.footer(
      R"(FILE is a volume (NIfTI, NRRD, MetaImage, OpenVDB, raw; a header's data may lie beside it), or for model, simplify,
register, measures, render and export a set of spheres (.csv or .npy with x y z r in mm).

Each command tells its options: spherule COMMAND --help. Most need to know what the object is:
  spherule measures head.nii.gz --threshold 60.5
  spherule render head.nii.gz --threshold 60.5 -o head.png
  spherule simplify head.nii.gz --threshold 60.5 --method best,k=64 -o few.csv
  spherule export few.csv -o few.urdf --file density=1050

Exit status: 0 done, 1 the data cannot be used, 2 the command line makes no sense.)");
  try {
    app.parse(argc, argv);
  } catch (const CLI::CallForHelp&) {
    r.options.help = app.help();
    return r.options;
  } catch (const CLI::ConversionError&) {
    throw UsageError("--below, --above and --plain take no value.");
  } catch (const CLI::ParseError&) {
    refuse(app.get_subcommands().empty() ? app : *app.get_subcommands().front(), argv[argc - 1]);
  }
  check_words(app, r.options);
  r.options.command = app.get_subcommands().front()->get_name();
  if (r.options.rule) r.options.rule->border = r.border;
  r.options.render = parse_render_options(r.picture);
  return r.options;
}

}  // namespace spherule::cli
