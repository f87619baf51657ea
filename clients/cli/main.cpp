// SPDX-License-Identifier: GPL-3.0-or-later
//
// spherule: one stage, or the whole pipeline, on a file, without the server.
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <new>
#include <optional>
#include <span>

#include "clients/cli/files.h"
#include "clients/cli/options.h"
#include "clients/cli/report.h"
#include "core/base/error.h"
#include "core/boundary.h"
#include "core/compare/marching_cubes.h"
#include "core/measure/checks.h"
#include "core/measure/report.h"
#include "core/measure/union.h"
#include "core/pipeline.h"
#include "core/register/itk.h"
#include "core/register/register.h"
#include "core/simplify/simplify.h"
#include "core/write/export.h"
#include "core/write/export_file.h"

namespace spherule::cli {
namespace {

class Stopwatch {
 public:
  double seconds() const { return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count(); }

 private:
  std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
};

double peak_memory_mib() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024;
}

// A line that is written over; only where somebody watches. A stage may go over its work more than once: what is shown
// of it never goes back, and once it is done it is not shown again.
class ProgressLine {
 public:
  /// For one run of each stage.
  Context context(unsigned threads) {
    Context context;
    context.threads = threads;
    if (isatty(STDERR_FILENO) != 0) {
      // Shared, since stages hand on copies of their context.
      context.progress = [this, reached = std::make_shared<std::map<std::string, int, std::less<>>>()](
                             std::string_view stage, double fraction) {
        auto known = reached->find(stage);
        if (known == reached->end()) known = reached->emplace(stage, -1).first;
        const int percent = static_cast<int>(100 * fraction);
        if (percent <= known->second) return;
        known->second = percent;
        show(stage, percent);
      };
    }
    return context;
  }
  void clear() {
    if (shown_) std::fputs("\r\033[K", stderr);
    shown_ = false;
  }

 private:
  void show(std::string_view stage, int percent) {
    if (percent >= 100) return clear();
    std::fprintf(stderr, "\r\033[K%.*s %d %%", static_cast<int>(stage.size()), stage.data(), percent);
    shown_ = true;
  }

  bool shown_ = false;
};

using Table = std::string (*)(std::span<const Sphere>, std::span<const SphereColumn>);

// By the file's ending; nullptr when it is no table.
Table table_format(const std::filesystem::path& path) {
  constexpr std::array<std::pair<std::string_view, Table>, 4> kFormats{
      {{".csv", spheres_to_csv}, {".npy", spheres_to_npy}, {".ply", spheres_to_ply}, {".vtp", spheres_to_vtp}}};
  const auto found = std::ranges::find(kFormats, path.extension().string(), &std::pair<std::string_view, Table>::first);
  return found == kFormats.end() ? nullptr : found->second;
}

// By the file's ending, which may have two dots.
std::optional<FileFormat> other_format(const std::filesystem::path& path) {
  const std::string name = path.filename().string();
  for (std::size_t f = 0; f < file_format_count; ++f) {
    const auto format = static_cast<FileFormat>(f);
    if (name.ends_with("." + std::string(info(format).extension))) return format;
  }
  return std::nullopt;
}

bool holds_spheres(const Options& options, const std::vector<std::filesystem::path>& files) {
  const auto ending = files.front().extension();
  return files.size() == 1 && !options.read.raw && (ending == ".csv" || ending == ".npy");
}

// A command at work: its options, what it prints, and how long each stage took.
struct Run {
  const Options& options;
  const std::vector<std::filesystem::path>& files;
  ProgressLine& line;
  Report& report;
  const Context context = line.context(options.threads);
  std::vector<StageTime> timings{};
  std::optional<Grid> scan{};             // of the volume that was read
  std::optional<InsideSamples> inside{};  // of its object, where a mask is to be that

  template <typename F>
  auto timed(const char* stage, F&& work) {
    const Stopwatch watch;
    auto result = work();
    timings.push_back({stage, watch.seconds()});
    return result;
  }

  Volume read() {
    Volume volume = timed("read", [&] { return read_volume(with_data(files), options.read, context); });
    for (const std::string& warning : volume.warnings) report.row("warning", std::string_view(warning));
    scan = volume.grid;
    return volume;
  }

  ObjectRule rule(const Volume& volume) const {
    ObjectRule rule = *options.rule;
    rule.side = options.side.value_or(rule.kind == ObjectRule::Kind::threshold ? volume.natural_side : Side::above);
    return rule;
  }

  BuiltModel build(const Volume& volume) {
    BuiltModel built = build_model(volume, rule(volume), {}, context);
    timings.insert(timings.end(), built.timings.begin(), built.timings.end());
    for (const std::string& warning : built.warnings) report.row("warning", std::string_view(warning));
    return built;
  }

  // The model of a volume, or the spheres that the file holds.
  BuiltModel obtain() {
    if (!holds_spheres(options, files)) return build(read());
    BuiltModel built;
    built.model.spheres = timed("read", [&] { return read_spheres(files.front()); });
    return built;
  }

  void export_spheres(std::span<const Sphere> spheres) {
    if (options.out.empty()) return;
    write_file(options.out, timed("export", [&] {
                 if (const Table table = table_format(options.out)) return table(spheres, {});
                 const FileFormat format = *other_format(options.out);
                 std::optional<UnionMeasures> whole;
                 if (needs_union(format)) whole.emplace(measure_union(spheres, context));
                 return spheres_to_file(format,
                                        {.spheres = spheres,
                                         .scan = scan ? &*scan : nullptr,
                                         .inside = inside ? &inside->inside : nullptr,
                                         .whole = whole ? &*whole : nullptr},
                                        parse_file_options(format, options.file), context);
               }));
  }

  void counts(const BuiltModel& built) {
    report.heading("Model");
    if (built.model.solid) {
      report.row("boundary_points", std::uint64_t{built.model.solid->boundary.points.size()});
      report.row("tetrahedra", std::uint64_t{built.model.solid->cells.size()});
      report.row("inside_tetrahedra", std::uint64_t{built.model.solid->inside_count});
      report.row("boundary_point_density", built.boundary_point_density_mm, "mm");
    }
    report.row("spheres", std::uint64_t{built.model.spheres.size()});
    const Box box = bounds(built.model);
    if (box.empty()) return;
    report.row("bounds_min", box.min, "mm");
    report.row("bounds_max", box.max, "mm");
  }

  void costs() {
    report.heading("Costs");
    double total = 0;
    for (const auto& [stage, seconds] : timings) {
      report.row(stage + "_time", seconds, "s");
      total += seconds;
    }
    report.row("total_time", total, "s");
    report.row("peak_memory", peak_memory_mib(), "MiB");
  }

  void info() {
    const Volume volume = read();
    const ValueRange range = value_range(volume, context);
    const Grid& grid = volume.grid;
    report.heading("Volume");
    report.row("format", std::string_view(volume.format));
    report.row("dims", std::string_view(std::to_string(grid.dims[0]) + ' ' + std::to_string(grid.dims[1]) + ' ' +
                                        std::to_string(grid.dims[2])));
    report.row("spacing", grid.spacing, "mm");
    report.row("origin", grid.origin, "mm");
    for (int axis = 0; axis < 3; ++axis)
      report.row("direction_" + std::string(1, "ijk"[axis]), grid.direction.column(axis));
    report.row("type", name(volume.type));
    report.row("slope", volume.slope);
    report.row("intercept", volume.intercept);
    report.row("min", range.min);
    report.row("max", range.max);
    report.row("not_finite", std::uint64_t{range.not_finite});
    report.row("inside", volume.natural_side == Side::below ? "below" : "above");
  }

  void points() {
    const Volume volume = read();
    const ObjectRule object = rule(volume);
    const auto samples = timed("samples", [&] { return classify_samples(volume, object, context); });
    const auto boundary =
        timed("boundary", [&] { return extract_boundary(volume, object, samples, ModelLimits{}.max_points, context); });
    report.heading("Boundary");
    report.row("inside_samples", samples.inside.count());
    report.row("boundary_points", std::uint64_t{boundary.points.size()});
    report.row("touches_border", boundary.touches_border ? "yes" : "no");
    report.row("lattice_unit", boundary.lattice.unit_mm, "mm");
    if (options.out.empty()) return;
    std::vector<Sphere> spheres;
    spheres.reserve(boundary.points.size());
    for (const LatticePoint& p : boundary.points) spheres.push_back({boundary.lattice.to_patient(p), 0});
    export_spheres(spheres);
  }

  void model() {
    std::optional<Volume> volume;
    if (!holds_spheres(options, files)) volume.emplace(read());
    const BuiltModel built = volume ? build(*volume) : obtain();
    counts(built);
    if (volume && !options.out.empty() && !table_format(options.out) &&
        mask_needs_samples(*other_format(options.out), parse_file_options(*other_format(options.out), options.file),
                           built.model)) {
      inside.emplace(classify_samples(*volume, rule(*volume), context));
    }
    export_spheres(built.model.spheres);
  }

  void simplify() {
    std::optional<Volume> volume;
    ObjectRule object;
    if (!holds_spheres(options, files)) {
      volume.emplace(read());
      object = rule(*volume);
    }
    const BuiltModel built = volume ? build(*volume) : obtain();
    counts(built);
    const SampledObject samples = timed("object", [&] {
      if (!volume) return sample_union(built.model.spheres, std::size_t{1} << 22, context);
      return SampledObject{
          .grid = volume->grid, .inside = classify_samples(*volume, object, context).inside, .border = object.border};
    });
    const Reference reference = timed("reference", [&] { return reference_of(built.model, context); });
    const Simplified simplified = spherule::simplify(built.model, samples, reference, *options.method, context);
    timings.push_back({"simplify", simplified.seconds});
    timings.push_back({"evaluate", simplified.evaluate_seconds});
    achieved(simplified);
    export_spheres(spheres_at(simplified.order, simplified.order.last_level()));
  }

  void achieved(const Simplified& simplified) {
    const Achieved& a = simplified.achieved;
    report.heading("Achieved");
    report.row("k", a.spheres);
    report.row("iou", a.iou);
    report.row("object_volume", a.object_mm3, "mm3");
    report.row("covered_volume", a.covered_mm3, "mm3");
    report.row("spilled_volume", a.spilled_mm3, "mm3");
    report.row("never_spills", a.never_spills ? "yes" : "no");
    report.row("covers_all", a.covers_all ? "yes" : "no");
    report.row("volume", a.volume_mm3, "mm3");
    report.row("volume_error", a.volume_error);
    report.row("area", a.area_mm2, "mm2");
    report.row("area_error", a.area_error);
    if (a.hausdorff) {
      report.row("hausdorff", a.hausdorff->mm, "mm");
      report.row("hausdorff_of_diagonal", a.hausdorff->of_diagonal);
      report.row("object_to_spheres", a.hausdorff->to_spheres, "mm");
      report.row("spheres_to_object", a.hausdorff->to_object, "mm");
    }
    topology("before", a.before);
    topology("after", a.after);
    if (simplified.optimality_gap) report.row("optimality_gap", *simplified.optimality_gap);
  }

  void register_pair() {
    const BuiltModel moving = obtain();
    Run of_fixed{options, options.fixed, line, report};
    const BuiltModel fixed = of_fixed.obtain();
    const Registration found = timed("register", [&] {
      return register_models(fixed.model, moving.model, {.transform = options.transform}, context);
    });
    const Decomposition parts = decompose(found.moving_to_fixed, found.centre);
    report.heading("Moving to fixed, LPS mm");
    for (std::size_t r = 0; r < 3; ++r) {
      const std::string name = "row_" + std::to_string(r);
      report.row(name, found.moving_to_fixed.linear.rows[r]);
    }
    report.row("shift", found.moving_to_fixed.shift, "mm");
    report.row("angle", parts.angle_deg, "deg");
    report.row("scale", scale_of(found.moving_to_fixed));
    report.heading("Quality");
    report.row("dice", found.overlap.dice);
    report.row("iou", found.overlap.iou);
    report.row("surface_mean", found.surfaces.mean_mm, "mm");
    report.row("surface_p95", found.surfaces.p95_mm, "mm");
    report.row("matched_share", found.matched_share);
    report.row("other_poses", std::uint64_t{found.others.size()});
    report.row("poor", found.poor ? "yes" : "no");
    for (const std::string& warning : found.warnings) report.row("warning", std::string_view(warning));
    if (!options.out.empty()) write_file(options.out, itk_transform(inverse(found.moving_to_fixed)));
  }

  void measures() {
    std::optional<Volume> volume;
    ObjectRule object;
    BuiltModel built;
    if (holds_spheres(options, files)) {
      built = obtain();
    } else {
      volume.emplace(read());
      object = rule(*volume);
      built = build(*volume);
    }
    counts(built);
    const auto whole = timed("union", [&] { return measure_union(built.model, context); });
    const auto measured = timed("measures", [&] {
      std::optional<MeasuredObject> source;
      if (volume) source.emplace(MeasuredObject{*volume, object});
      return measure_model(built.model, whole, source, context);
    });
    report.heading("Spheres");
    const SpheresMeasures& spheres = measured.spheres;
    mass("spheres", spheres.mass, spheres.area_mm2);
    topology("spheres", spheres.topology);
    report.row("least_radius", spheres.radius_min_mm, "mm");
    report.row("largest_radius", spheres.radius_max_mm, "mm");
    report.row("enclosing_sphere_centre", measured.smallest_enclosing.centre, "mm");
    report.row("enclosing_sphere_radius", measured.smallest_enclosing.radius, "mm");
    report.row("inscribed_sphere_centre", measured.largest_inscribed.centre, "mm");
    report.row("inscribed_sphere_radius", measured.largest_inscribed.radius, "mm");
    report.row("thickness_mean", measured.thickness.mean_mm, "mm");
    report.row("thickness_sd", measured.thickness.sd_mm, "mm");
    report.row("thickness_median", measured.thickness.percentiles_mm[2], "mm");
    report.row("components", std::uint64_t{measured.components.size()});
    if (!measured.components.empty()) {
      report.row("largest_component_spheres", measured.components.front().spheres);
      report.row("largest_component_volume", measured.components.front().volume_mm3, "mm3");
      report.row("largest_component_area", measured.components.front().area_mm2, "mm2");
    }
    if (!volume) return;
    report.heading("Tetrahedra");
    mass("tetrahedra", mass_properties(measured.tetrahedra->moments), measured.tetrahedra->area_mm2);
    topology("tetrahedra", measured.tetrahedra->topology);
    report.row("boundary_facets", measured.tetrahedra->boundary_facets);
    report.heading("For comparison");
    report.row("voxels", measured.voxels->count);
    report.row("voxels_volume", measured.voxels->volume_mm3, "mm3");
    report.row("marching_cubes_triangles", measured.marching_cubes->triangles);
    report.row("marching_cubes_volume", measured.marching_cubes->volume_mm3, "mm3");
    report.row("marching_cubes_area", measured.marching_cubes->area_mm2, "mm2");
    report.row("marching_cubes_euler_characteristic", whole_number(measured.marching_cubes->euler_characteristic));
    report.heading("Observations");
    const Observations& seen = *measured.observations;
    report.row("excess_volume", seen.excess_volume_mm3.value, "mm3");
    report.row("excess_volume_bound", seen.excess_volume_mm3.bound, "mm3");
    report.row("excess_volume_slack", seen.excess_volume_mm3.slack(), "mm3");
    report.row("density", seen.density_mm.value, "mm");
    report.row("density_bound", seen.density_mm.bound, "mm");
    report.row("density_slack", seen.density_mm.slack(), "mm");
  }

  static std::string whole_number(std::int64_t n) { return std::to_string(n); }

  void mass(const std::string& of, const MassProperties& mass, double area_mm2) {
    report.row(of + "_volume", mass.volume_mm3, "mm3");
    report.row(of + "_area", area_mm2, "mm2");
    report.row(of + "_centroid", mass.centroid_mm, "mm");
    const auto& m = mass.principal_moments_mm5;
    report.row(of + "_principal_moments", Vec3{m[0], m[1], m[2]}, "mm5");
    for (std::size_t i = 0; i < 3; ++i) {
      report.row(of + "_principal_axis_" + std::to_string(i + 1), mass.principal_axes.rows[i]);
    }
  }

  void topology(const std::string& of, const Topology& topology) {
    const auto& b = topology.betti;
    report.row(of + "_betti", whole_number(b[0]) + ' ' + whole_number(b[1]) + ' ' + whole_number(b[2]));
    report.row(of + "_euler_characteristic", whole_number(topology.euler_characteristic));
  }

  void checks() {
    const Volume volume = read();
    const BuiltModel built = build(volume);
    counts(built);
    const ObjectRule object = rule(volume);
    const auto samples = classify_samples(volume, object, context);
    const auto [criteria, limits] =
        timed("checks", [&] { return check_model(built.model, samples.inside, object.border, context); });
    report.heading("Checks");
    report.row("inside_samples_not_covered", criteria.inside_samples_not_covered);
    report.row("outside_samples_covered", criteria.outside_samples_covered);
    report.row("boundary_points_inside_balls", criteria.boundary_points_inside_balls);
    report.row("boundary_points_on_no_ball", criteria.boundary_points_on_no_ball);
    report.row("violations", criteria.violations());
    report.row("density", limits.density_mm, "mm");
    report.row("density_bound", limits.density_bound_mm, "mm");
    report.row("cells_per_point", limits.cells_per_point);
    report.row("tetrahedra_volume", limits.tetrahedra_volume_mm3, "mm3");
    report.row("spheres_volume_bound", limits.spheres_volume_bound_mm3, "mm3");
  }

  void render() {
    std::optional<Volume> volume;
    if (!holds_spheres(options, files)) volume.emplace(read());
    const BuiltModel built = volume ? build(*volume) : obtain();
    counts(built);
    std::optional<Mesh> surface;
    if (volume && options.render.style == Style::surface) {
      surface = timed("surface", [&] {
        const ObjectRule object = rule(*volume);
        return marching_cubes(*volume, object, classify_samples(*volume, object, context), built.model.solid->boundary,
                              context);
      });
    }
    const Subject subject{.model = &built.model, .surface = surface ? &*surface : nullptr};
    const auto frames = timed("render", [&] { return spherule::render(std::array{subject}, options.render, context); });
    const bool turns = options.render.turntable > 0;
    constexpr int kFramesPerSecond = 15;
    write_file(options.out, timed(turns ? "gif" : "png", [&] {
                 return turns ? encode_gif(frames, kFramesPerSecond, context) : encode_png(frames.front(), context);
               }));
  }

  void go() {
    const std::string& command = options.command;
    if (command == "info") return info();
    if (command == "points") points();
    if (command == "model" || command == "export") model();
    if (command == "simplify") simplify();
    if (command == "register") register_pair();
    if (command == "measures") measures();
    if (command == "checks") checks();
    if (command == "render") render();
    costs();
  }
};

// All that follows is said before hours of work, not after.

void check_output(const Options& options) {
  const bool picture = options.command == "render";
  if (options.out.empty()) {
    if (picture || options.command == "export") throw UsageError("Say where to: -o FILE.");
  } else if (picture) {
    const bool turns = options.render.turntable > 0;
    if (options.out.extension() != (turns ? ".gif" : ".png"))
      throw UsageError(turns ? "Turntables are GIF: -o FILE.gif." : "Pictures are PNG: -o FILE.png.");
  } else if (options.command == "register") {
    if (options.out.extension() != ".tfm") throw UsageError("Transforms are ITK's text files: -o FILE.tfm.");
  } else if (table_format(options.out) != nullptr) {
    if (!options.file.empty()) throw UsageError("Tables have no options; leave out --file.");
  } else if (const auto format = other_format(options.out); format && options.command != "points") {
    parse_file_options(*format, options.file);
  } else {
    throw UsageError("The output file has no ending of a file of spheres; see spherule --help.");
  }
  if (options.out.empty() && !options.file.empty()) throw UsageError("Say which file --file is for: -o FILE.");
}

// Whether each input says what it is, and no more.
void check_inputs(const Options& options) {
  const std::string& command = options.command;
  const bool takes_spheres = command != "info" && command != "points" && command != "checks";
  const bool spheres = takes_spheres && holds_spheres(options, options.files);
  const bool fixed_spheres = options.fixed.empty() || holds_spheres(options, options.fixed);
  if (command == "register" && options.fixed.empty()) throw UsageError("Say what to lay it on: --fixed FILE.");
  if (!options.rule && command != "info" && !(spheres && fixed_spheres))
    throw UsageError("Say what the object is: --threshold T, --range LO,HI or --labels A,B,...");
  if (options.rule && spheres && fixed_spheres) throw UsageError("A set of spheres has no threshold, range or labels.");
}

void check_picture(const RenderOptions& o, bool of_spheres) {
  check_render_options(o);
  if (of_spheres && (o.style == Style::tetrahedra || o.style == Style::surface || o.style == Style::points))
    throw UsageError("A set of spheres has no tetrahedra, surface or points; choose another --style.");
  // Where the object is is not known yet: what is looked at stands for it.
  if (const auto& viewpoint = o.camera.viewpoint; viewpoint && viewpoint->look_at) {
    const Box box = box_of(Sphere{*viewpoint->look_at, 1});
    static_cast<void>(make_camera(o.camera, View::anterior, 0, box, o.width, o.height));
  }
}

void check(const Options& options) {
  check_output(options);
  check_inputs(options);
  const bool spheres = holds_spheres(options, options.files);
  if (options.command == "simplify") {
    if (!options.method) throw UsageError("Say how to simplify: --method best,k=64; see spherule --help.");
    // How many spheres there are is not known yet.
    check_method(*options.method, std::numeric_limits<std::size_t>::max());
  }
  if (options.command == "register") check_registration_options({.transform = options.transform});
  if (options.command == "render") check_picture(options.render, spheres);
  if (const auto format = other_format(options.out); format && table_format(options.out) == nullptr) {
    check_exportable(*format, 1, !spheres, parse_file_options(*format, options.file));
  }
  check_readable(options.files);
  check_readable(options.fixed);
  if (!options.out.empty()) check_writable(options.out);
}

}  // namespace
}  // namespace spherule::cli

int main(int argc, char** argv) {
  using namespace spherule::cli;
  ProgressLine line;
  const auto fail = [&](int status, const char* sentence) {
    line.clear();
    std::fprintf(stderr, "spherule: %s\n", sentence);
    return status;
  };
  try {
    const Options options = parse(argc, argv);
    if (!options.help.empty()) {
      std::fputs(options.help.c_str(), stdout);
      return 0;
    }
    check(options);
    Report report(options.plain);
    Run{options, options.files, line, report}.go();
    line.clear();
    return 0;
  } catch (const UsageError& error) {
    return fail(2, error.what());
  } catch (const spherule::Error& error) {
    return fail(error.code() == spherule::ErrorCode::invalid_argument ? 2 : 1, error.what());
  } catch (const std::bad_alloc&) {
    return fail(1, "There is not enough memory for this; choose a smaller volume or part of it.");
  } catch (const std::exception& error) {
    return fail(3, (std::string("This is a defect of the program, please report it: ") + error.what()).c_str());
  }
}
