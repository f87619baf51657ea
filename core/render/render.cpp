// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/render.h"

#include <algorithm>
#include <cmath>

#include "core/base/check.h"
#include "core/base/elementary.h"
#include "core/base/error.h"
#include "core/base/ranges.h"
#include "core/compare/marching_cubes.h"
#include "core/measure/solid.h"
#include "core/measure/union.h"
#include "core/render/annotate.h"
#include "core/render/blob_balls.h"
#include "core/render/colouring.h"
#include "core/render/patches.h"

namespace spherule {
namespace {

constexpr std::array<Colour, 2> kMaterials{Colour{0.90, 0.71, 0.50}, Colour{0.36, 0.58, 0.82}};

}  // namespace

void check_render_options(const RenderOptions& o) {
  std::vector<FieldError> fields;
  const auto need = [&](bool good, const char* field, const std::string& detail) {
    if (!good) fields.push_back({field, detail});
  };
  const auto within = [&](const auto& range, auto value, const char* field, const char* unit = "") {
    need(range.holds(value), field, "must be " + range.words() + unit);
  };
  within(ranges::pixels, o.width, "width", " pixels");
  within(ranges::pixels, o.height, "height", " pixels");
  within(ranges::samples, o.samples_per_axis, "samples");
  within(ranges::smoothness, o.smoothness, "smoothness");
  within(ranges::length_mm, o.point_radius_mm, "point_radius", " mm");
  within(ranges::length_mm, o.min_radius_mm, "min_radius", " mm");
  if (o.max_radius_mm) within(ranges::length_mm, *o.max_radius_mm, "max_radius", " mm");
  need(!o.max_radius_mm || *o.max_radius_mm >= o.min_radius_mm, "max_radius", "must be no less than min_radius");
  within(ranges::bucket_count, o.bucket_count, "bucket_count");
  need(std::ranges::all_of(o.buckets, [&](int b) { return b >= 0 && b < o.bucket_count; }), "buckets",
       "must be numbers of buckets, from 0 to bucket_count - 1");
  need(!o.views.empty() && o.views.size() <= 6, "views", "must be one to six");
  need(!o.clip_normal || is_direction(*o.clip_normal), "clip",
       "must have a normal " + ranges::direction.words() + ", not all near zero");
  need(!o.clip_offset_mm || ranges::place_mm.holds(*o.clip_offset_mm), "clip",
       "must have an offset " + ranges::place_mm.words() + " mm");
  need(o.turntable == 0 || (o.turntable >= 2 && o.turntable <= ranges::turntable.most), "turntable",
       "must be within 2 and 360 frames");
  within(ranges::opacity, o.opacity, "opacity");
  need(o.colour_map.empty() || colour_map(o.colour_map) != nullptr, "colour_map",
       "must be one of ember, lagoon, grey and tide");
  if (o.colour_range) {
    const auto [lo, hi] = *o.colour_range;
    need(lo < hi && ranges::colour_range.holds(lo) && ranges::colour_range.holds(hi), "colour_range",
         "must be two numbers " + ranges::colour_range.words() + ", the first below the second");
    need(o.colour_by != ColourBy::contribution || lo > 0, "colour_range", "must be above 0 where it is logarithmic");
  }
  for (FieldError& fault : camera_faults(o.camera)) fields.push_back(std::move(fault));
  if (!fields.empty())
    throw Error(ErrorCode::invalid_argument,
                "The picture's " + fields.front().pointer + ' ' + fields.front().detail + '.', fields);
}

namespace {

[[noreturn]] void unusable(const char* sentence) { throw Error(ErrorCode::unusable, sentence); }

double median_radius(std::span<const Sphere> balls) {
  std::vector<double> radii;
  for (const Sphere& s : balls)
    if (s.radius > 0) radii.push_back(s.radius);
  const auto middle = radii.begin() + static_cast<std::ptrdiff_t>(radii.size() / 2);
  std::nth_element(radii.begin(), middle, radii.end());
  return *middle;
}

// Everything that is drawn of one subject, kept while rays ask for it.
struct Drawn {
  std::vector<Sphere> own;            // balls that the model itself does not have
  std::span<const Sphere> balls;      // of spheres and blobs, or small ones for points
  std::vector<std::uint32_t> source;  // of each ball, or facet: the model's sphere; empty: the same number
  std::vector<Patch> patches;
  std::vector<Vec3> vertices;
  std::vector<Triangle> triangles;
  bool of_balls = true;  // else of facets
  double blend_mm = 0;   // of blobs; 0: they are balls
};

// Shorter blending is not seen: of the radius at which a picture's least pixel is a thousandth of a ball, and of the
// scene, of which a picture shows no finer part. It is too short for the fields, too: they are computed to the ratio of
// a radius to the blending distance, in units of 2⁻⁵³.
constexpr double kLeastSmoothness = 1e-3, kLeastBlend = 0x1p-24;

// The distance over which balls blend into each other.
double blend_of(std::span<const Sphere> balls, double smoothness) {
  if (smoothness < kLeastSmoothness) return 0;
  Box box;
  for (const Sphere& s : balls)
    if (s.radius > 0) box.include(s);
  const double blend = smoothness * median_radius(balls);
  return blend >= kLeastBlend * norm(box.max - box.min) ? blend : 0;
}

// The model's balls that the filters leave; all of them as an empty list.
std::vector<std::uint32_t> chosen(const SphereModel& model, const RenderOptions& o) {
  if (o.min_radius_mm <= 0 && !o.max_radius_mm && o.buckets.empty()) return {};
  std::vector<char> wanted(static_cast<std::size_t>(o.bucket_count), o.buckets.empty());
  for (const int b : o.buckets) wanted[static_cast<std::size_t>(b)] = 1;
  const RadiusHistogram histogram = radius_histogram(model.spheres, static_cast<std::size_t>(o.bucket_count));
  const double width = (histogram.max_mm - histogram.min_mm) / o.bucket_count;
  std::vector<std::uint32_t> kept;
  for (std::uint32_t i = 0; i < model.spheres.size(); ++i) {
    const double r = model.spheres[i].radius;
    if (!(r > 0) || r < o.min_radius_mm || (o.max_radius_mm && r > *o.max_radius_mm)) continue;
    const double bucket = width > 0 ? std::floor((r - histogram.min_mm) / width) : 0;
    if (wanted[static_cast<std::size_t>(std::clamp(bucket, 0.0, o.bucket_count - 1.0))] != 0) kept.push_back(i);
  }
  if (kept.empty()) unusable("No sphere passes the radius and bucket filters; widen them.");
  return kept;
}

// Facets between a kept cell and anything else, anticlockwise as seen from outside.
void take_facets(const Solid& solid, const std::vector<std::uint32_t>& kept, const Context& context, Drawn& drawn) {
  std::vector<Tetrahedron> cells;
  if (kept.empty()) {
    cells.assign(solid.cells.begin(), solid.cells.begin() + static_cast<std::ptrdiff_t>(solid.inside_count));
  } else {
    for (const std::uint32_t c : kept) cells.push_back(solid.cells[c]);
  }
  const auto across = neighbours(cells, solid.boundary.points.size(), context);
  std::vector<std::uint32_t> name(solid.boundary.points.size(), no_primitive);
  // The facet opposite vertex i of a positive cell.
  constexpr std::array<std::array<std::size_t, 3>, 4> kFacets{{{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}}};
  for (std::size_t c = 0; c < cells.size(); ++c) {
    if (c % 65536 == 0) context.throw_if_cancelled();
    for (std::size_t i = 0; i < 4; ++i) {
      if (across[c][i] != no_cell) continue;
      Triangle triangle;
      for (std::size_t v = 0; v < 3; ++v) {
        const std::uint32_t point = cells[c][kFacets[i][v]];
        if (name[point] == no_primitive) {
          name[point] = static_cast<std::uint32_t>(drawn.vertices.size());
          drawn.vertices.push_back(solid.boundary.lattice.to_patient(solid.boundary.points[point]));
        }
        triangle[v] = name[point];
      }
      drawn.triangles.push_back(triangle);
      drawn.source.push_back(kept.empty() ? static_cast<std::uint32_t>(c) : kept[c]);
    }
  }
  // A left-handed grid mirrors the lattice.
  if (determinant(solid.boundary.lattice.grid.direction) < 0)
    for (Triangle& t : drawn.triangles) std::swap(t[1], t[2]);
  drawn.of_balls = false;
}

// Balls of one radius in place of points.
void take_small_balls(const SphereModel& model, const RenderOptions& o, const std::vector<Vec3>& centres,
                      const Context& context, Drawn& drawn) {
  double usual = 0.2 * median_radius(model.spheres);
  if (model.solid) {
    const Vec3 spacing = model.solid->boundary.lattice.grid.spacing;
    usual = 0.3 * std::min({spacing.x, spacing.y, spacing.z});
  }
  const double radius = o.point_radius_mm > 0 ? o.point_radius_mm : usual;
  for (const Vec3 c : centres) drawn.own.push_back({c, radius});
  drawn.balls = drawn.own;
  // Larger ones may all lie in each other, and a ray must not try them all.
  if (radius > usual) {
    drawn.patches = visible_patches({.spheres = drawn.own, .solid = {}}, context);
    return;
  }
  for (std::uint32_t i = 0; i < drawn.own.size(); ++i) drawn.patches.push_back({box_of(drawn.own[i]), i});
}

// Of the balls that drawn.source numbers, all of the model as an empty list: those that blend.
void take_blending_balls(std::span<const Sphere> balls, const Context& context, Drawn& drawn) {
  // What of a ball may be out of another that blends for it: a sixteenth of what the surface may be out of both.
  const std::vector<std::uint32_t> blending = blending_balls(balls, drawn.blend_mm / 16, context);
  std::vector<std::uint32_t> source;
  for (const std::uint32_t i : blending) {
    drawn.own.push_back(balls[i]);
    source.push_back(drawn.source.empty() ? i : drawn.source[i]);
  }
  drawn.source = std::move(source);
  drawn.balls = drawn.own;
}

const Solid& solid_of(const SphereModel& model, const char* what) {
  if (!model.solid) {
    throw Error(ErrorCode::unusable,
                std::string("This model has no ") + what + "; draw the spheres, or the model that it was made from.");
  }
  return *model.solid;
}

Drawn drawn_of(const Subject& subject, const RenderOptions& o, const Context& context) {
  const SphereModel& model = *subject.model;
  Drawn drawn;
  switch (o.style) {
    case Style::spheres:
    case Style::blobs: {
      drawn.source = chosen(model, o);
      SphereModel part;
      for (const std::uint32_t i : drawn.source) part.spheres.push_back(model.spheres[i]);
      const SphereModel& shown = drawn.source.empty() ? model : part;
      if (o.style == Style::blobs) drawn.blend_mm = blend_of(shown.spheres, o.smoothness);
      if (drawn.blend_mm > 0) {
        take_blending_balls(shown.spheres, context, drawn);
        break;
      }
      if (drawn.source.empty() && !subject.patches.empty()) {
        drawn.patches.assign(subject.patches.begin(), subject.patches.end());
      } else {
        drawn.patches = visible_patches(shown, context);
      }
      drawn.balls = model.spheres;
      if (!drawn.source.empty()) {
        drawn.own = std::move(part.spheres);
        drawn.balls = drawn.own;
      }
      break;
    }
    case Style::tetrahedra: take_facets(solid_of(model, "tetrahedra"), chosen(model, o), context, drawn); break;
    case Style::surface:
      if (subject.surface == nullptr) {
        unusable("A surface is drawn only in a picture of models that were made from a volume; choose another style.");
      }
      drawn.vertices = subject.surface->vertices;
      drawn.triangles = subject.surface->triangles;
      drawn.of_balls = false;
      break;
    case Style::points: {
      const BoundaryPoints& boundary = solid_of(model, "boundary points").boundary;
      std::vector<Vec3> points;
      for (const LatticePoint& p : boundary.points) points.push_back(boundary.lattice.to_patient(p));
      take_small_balls(model, o, points, context, drawn);
      break;
    }
    case Style::centres: {
      drawn.source = chosen(model, o);
      std::vector<Vec3> centres;
      if (drawn.source.empty()) {
        for (std::uint32_t i = 0; i < model.spheres.size(); ++i)
          if (model.spheres[i].radius > 0) drawn.source.push_back(i);
      }
      for (const std::uint32_t i : drawn.source) centres.push_back(model.spheres[i].centre);
      take_small_balls(model, o, centres, context, drawn);
      break;
    }
  }
  if (drawn.of_balls ? drawn.balls.empty() : drawn.triangles.empty())
    unusable("The model has nothing that this style draws; choose another style.");
  return drawn;
}

std::unique_ptr<const Tracer> tracer_of(const Drawn& drawn, const RenderOptions& o,
                                        const std::optional<HalfSpace>& clip, const Context& context) {
  if (!drawn.of_balls) return trace_facets(drawn.vertices, drawn.triangles, o.style == Style::surface, context);
  if (drawn.blend_mm > 0) return trace_blobs(drawn.balls, drawn.blend_mm, context);
  return trace_balls(drawn.balls, drawn.patches, clip, context);
}

// The number that each ball (tetrahedra: facet; surface: vertex) is coloured by.
std::vector<double> numbers_of(const Subject& subject, const Drawn& drawn, const RenderOptions& o,
                               const Context& context) {
  const SphereModel& model = *subject.model;
  const bool of_spheres = o.style != Style::surface && o.style != Style::points;
  std::vector<double> all;
  switch (o.colour_by) {
    case ColourBy::radius:
    case ColourBy::contribution:
    case ColourBy::cluster:
      if (!of_spheres)
        throw Error(
            ErrorCode::invalid_argument,
            "Points and the surface belong to no sphere; colour them by component, or the surface by curvature.",
            {{"colour_by", "must be none, component or curvature for this style"}});
      if (o.colour_by == ColourBy::contribution && !subject.contributions_mm3.empty()) {
        all.assign(subject.contributions_mm3.begin(), subject.contributions_mm3.end());
      } else if (o.colour_by == ColourBy::contribution) {
        for (const BallPart& part : measure_union(model, context).parts) all.push_back(part.volume_mm3);
      } else {
        for (std::size_t i = 0; i < model.spheres.size(); ++i)
          all.push_back(o.colour_by == ColourBy::radius ? model.spheres[i].radius : static_cast<double>(i));
      }
      break;
    case ColourBy::component:
      if (o.style == Style::surface) {
        for (const std::uint32_t c : pieces(drawn.vertices.size(), drawn.triangles, context)) all.push_back(c);
        return all;
      }
      if (o.style == Style::points) {
        const auto of_cell = pieces(model, context);
        all.assign(model.solid->boundary.points.size(), 0);
        for (std::size_t c = 0; c < model.solid->inside_count; ++c)
          for (const std::uint32_t p : model.solid->cells[c]) all[p] = of_cell[c];
        return all;
      }
      for (const std::uint32_t c : pieces(model, context)) all.push_back(c);
      break;
    case ColourBy::none:
    case ColourBy::curvature: return {};
  }
  if (drawn.source.empty()) return all;
  std::vector<double> of_drawn;
  for (const std::uint32_t i : drawn.source) of_drawn.push_back(all[i]);
  return of_drawn;
}

// Numbers that are seen: of balls with a patch, of every facet.
std::vector<double> seen_numbers(const Drawn& drawn, const std::vector<double>& numbers) {
  if (drawn.patches.empty()) return numbers;
  std::vector<double> seen;
  for (const Patch& patch : drawn.patches) seen.push_back(numbers[patch.ball]);
  return seen;
}

// Gives the bodies their colours, and says what they mean.
std::optional<Legend> colour(std::span<const Subject> subjects, std::span<const Drawn> drawn, const RenderOptions& o,
                             const Context& context, std::span<Body> bodies) {
  if (o.colour_by == ColourBy::none) return std::nullopt;
  if (o.colour_by == ColourBy::component || o.colour_by == ColourBy::cluster) {
    for (std::size_t b = 0; b < bodies.size(); ++b)
      for (const double n : numbers_of(subjects[b], drawn[b], o, context))
        bodies[b].table.push_back(category_colour(static_cast<std::size_t>(n)));
    return std::nullopt;
  }
  Legend legend;
  const bool curvature = o.colour_by == ColourBy::curvature;
  legend.map = colour_map(!o.colour_map.empty() ? o.colour_map : curvature ? "tide" : "ember");
  legend.title = curvature ? "curvature" : o.colour_by == ColourBy::radius ? "radius" : "contribution";
  legend.unit = curvature ? "1/mm" : o.colour_by == ColourBy::radius ? "mm" : "mm³";
  legend.logarithmic = o.colour_by == ColourBy::contribution;
  std::vector<std::vector<double>> numbers;
  std::vector<double> seen;
  for (std::size_t b = 0; b < bodies.size(); ++b) {
    numbers.push_back(numbers_of(subjects[b], drawn[b], o, context));
    const auto some = curvature ? bodies[b].tracer->typical_curvatures() : seen_numbers(drawn[b], numbers[b]);
    seen.insert(seen.end(), some.begin(), some.end());
  }
  std::array<double, 2> range = o.colour_range.value_or(middle_range(seen));
  if (!o.colour_range && curvature) {
    const double most = std::max(std::abs(range[0]), std::abs(range[1]));
    range = {-most, most};
  }
  if (legend.logarithmic) range[0] = std::max({range[0], 1e-6 * range[1], 1e-300});
  legend.lo = range[0], legend.hi = std::max(range[1], range[0]);
  for (std::size_t b = 0; b < bodies.size(); ++b) {
    if (curvature) {
      bodies[b].curvature_map = legend.map;
      bodies[b].curvature_range = range;
      continue;
    }
    for (const double n : numbers[b]) {
      double t = (n - range[0]) / (range[1] - range[0]);
      if (legend.logarithmic) t = n > 0 ? elementary::log(n / range[0]) / elementary::log(range[1] / range[0]) : 0;
      bodies[b].table.push_back(legend.map->at(t));
    }
  }
  return legend;
}

// The shared scale: cameras that fit their own view would not compare.
void to_one_scale(std::span<Camera> cameras) {
  double scale = 0, distance = 0;
  for (const Camera& c : cameras) scale = std::max(scale, c.mm_per_pixel), distance = std::max(distance, c.distance);
  for (Camera& c : cameras) c.mm_per_pixel = scale, c.distance = distance;
}

const char* name_of(View view) {
  switch (view) {
    case View::anterior: return "anterior";
    case View::posterior: return "posterior";
    case View::right: return "right";
    case View::left: return "left";
    case View::head: return "superior";
    case View::foot: break;
  }
  return "inferior";
}

void refuse_cameras_inside(std::span<const Camera> cameras, const std::optional<HalfSpace>& clip,
                           std::span<const Body> bodies) {
  for (const Camera& camera : cameras) {
    const Vec3 eye = camera.centre - camera.distance * camera.forward;
    if (clip && dot(clip->normal, eye) > clip->offset) continue;
    for (const Body& body : bodies)
      if (body.tracer->inside(eye))
        throw Error(ErrorCode::invalid_argument, "The camera stands inside the object; move its position out of it.",
                    {{"position", "must be outside the object"}});
  }
}

// A picture needs places that float64 tells apart: 2⁸ of them across the object, wherever it is. The largest object
// drawn is one of 1e9 mm by the largest scale of a registration, the least half a radius that is imported.
void require_drawable(const Box& box) {
  const double size = norm(box.max - box.min);
  double farthest = 0;
  for (int a = 0; a < 3; ++a) farthest = std::max({farthest, std::abs(box.min[a]), std::abs(box.max[a])});
  if (!(size <= 1e20)) unusable("The object is larger than 1e20 mm, which cannot be drawn; scale it down.");
  if (!(size >= 1e-20)) unusable("The object is smaller than 1e-20 mm, which cannot be drawn; scale it up.");
  if (!(size >= 0x1p-44 * farthest))
    unusable("The object is too small for its distance from the origin to be drawn; move it nearer to the origin.");
}

// Where panels lie in a picture; the legend has a strip at its right.
struct Sheet {
  int columns = 1, rows = 1;
  int panel_width = 0, strip = 0;
  bool a_model_a_column = false, a_model_a_row = false;
};

Sheet sheet_of(const RenderOptions& o, std::size_t views, std::size_t subjects, const std::optional<Legend>& legend) {
  Sheet sheet;
  const bool beside = o.layout == Layout::beside && subjects > 1;
  sheet.a_model_a_column = beside && views == 1;
  sheet.a_model_a_row = beside && views > 1;
  sheet.columns = static_cast<int>(sheet.a_model_a_column ? subjects : views);
  sheet.rows = static_cast<int>(sheet.a_model_a_row ? subjects : 1);
  if (legend && o.legend) sheet.strip = Notes(o.width, o.height, o.background).legend_width(*legend);
  sheet.panel_width = (sheet.columns * o.width - sheet.strip) / sheet.columns;
  sheet.strip = sheet.columns * (o.width - sheet.panel_width);
  if (sheet.panel_width < 16 && sheet.strip > 0)
    throw Error(ErrorCode::invalid_argument, "The picture is too narrow for a legend; ask for a wider one or for none.",
                {{"width", "must leave room for the legend"}});
  return sheet;
}

Context without_progress(const Context& context) {
  Context quiet = context;
  quiet.progress = nullptr;
  return quiet;
}

Box box_of(std::span<const Subject> subjects) {
  Box box;
  for (const Subject& subject : subjects)
    for (const Sphere& s : subject.model->spheres)
      if (s.radius > 0) box.include(s);
  if (box.empty()) unusable("The model has no sphere with a radius above 0, so there is nothing to draw.");
  require_drawable(box);
  return box;
}

std::optional<HalfSpace> clip_of(const RenderOptions& o, const Box& box) {
  if (!o.clip_normal) return std::nullopt;
  const Vec3 n = normalised(*o.clip_normal);
  return HalfSpace{n, o.clip_offset_mm.value_or(dot(n, 0.5 * (box.min + box.max)))};
}

std::vector<Body> bodies_of(std::span<const Drawn> drawn, const RenderOptions& o, const std::optional<HalfSpace>& clip,
                            const Context& context) {
  std::vector<Body> bodies;
  for (std::size_t i = 0; i < drawn.size(); ++i) {
    Body body;
    body.tracer = tracer_of(drawn[i], o, clip, context);
    body.material = kMaterials[i];
    if (i == 0) body.opacity = o.opacity;
    bodies.push_back(std::move(body));
  }
  return bodies;
}

// Of each frame, one for each view.
std::vector<Camera> cameras_of(const RenderOptions& o, std::span<const View> views, const Box& box, int width) {
  const int frames = std::max(1, o.turntable);
  std::vector<Camera> cameras;
  for (int frame = 0; frame < frames; ++frame)
    for (const View view : views)
      cameras.push_back(make_camera(o.camera, view, 360.0 * frame / frames, box, width, o.height));
  to_one_scale(cameras);
  return cameras;
}

// One with all bodies, or one for each.
std::vector<Scene> scenes_of(std::vector<Body> bodies, std::span<const Drawn> drawn, const RenderOptions& o,
                             const std::optional<HalfSpace>& clip, std::size_t count) {
  std::vector<Scene> scenes(count);
  for (std::size_t b = 0; b < bodies.size(); ++b) {
    Scene& scene = scenes[std::min(b, count - 1)];
    scene.clip = clip;
    scene.shadows = o.shadows;
    scene.ambient_occlusion = o.ambient_occlusion;
    scene.specks.insert(scene.specks.end(), drawn[b].balls.begin(), drawn[b].balls.end());
    scene.bodies.push_back(std::move(bodies[b]));
  }
  return scenes;
}

// Everything that a frame shows but its cameras.
struct Setting {
  const RenderOptions& options;
  const std::vector<View>& views;
  const Sheet& sheet;
  const std::vector<Scene>& scenes;
  const std::optional<Legend>& legend;
};

// `cameras`: one a view. `panel_done` is called after each panel; the rays of one are reported to `context`.
template <typename F>
Image draw_frame(const Setting& s, std::span<const Camera> cameras, const Context& context, F&& panel_done) {
  const RenderOptions& o = s.options;
  const Sheet& sheet = s.sheet;
  const Context quiet = without_progress(context);
  Image image = backdrop(sheet.columns * o.width, sheet.rows * o.height, o.background);
  for (int row = 0; row < sheet.rows; ++row) {
    for (int column = 0; column < sheet.columns; ++column) {
      const std::size_t view = sheet.a_model_a_column ? 0 : static_cast<std::size_t>(column);
      const int scene = sheet.a_model_a_column ? column : row;
      const Camera& camera = cameras[view];
      Image panel = shoot(s.scenes[static_cast<std::size_t>(scene)], camera,
                          {sheet.panel_width, o.height, o.samples_per_axis, o.background}, "render", context);
      Notes notes(sheet.panel_width, o.height, o.background);
      if (s.views.size() > 1 && row == 0) notes.caption(name_of(s.views[view]));
      if (o.scale_bar) notes.scale_bar(camera);
      if (o.orientation_marker) notes.orientation(camera);
      paint(notes.drawing(), panel, quiet);
      place(panel, column * sheet.panel_width, row * o.height, image);
      panel_done();
    }
  }
  if (sheet.strip > 0) {
    Notes notes(sheet.columns * o.width, o.height, o.background);
    notes.legend(*s.legend);
    paint(notes.drawing(), image, quiet);
  }
  return image;
}

}  // namespace

std::uint64_t pixels_of(const RenderOptions& options, std::size_t subjects) {
  const std::uint64_t views = options.camera.viewpoint ? 1 : options.views.size();
  const std::uint64_t panels = views * (options.layout == Layout::beside ? subjects : 1);
  return static_cast<std::uint64_t>(options.width) * static_cast<std::uint64_t>(options.height) * panels *
         static_cast<std::uint64_t>(std::max(1, options.turntable));
}

std::vector<Image> render(std::span<const Subject> subjects, const RenderOptions& o, const Context& context) {
  SPHERULE_CHECK(!subjects.empty() && subjects.size() <= kMaterials.size());
  check_render_options(o);
  const Box box = box_of(subjects);
  const std::vector<View> views = o.camera.viewpoint ? std::vector<View>{View::anterior} : o.views;
  // A camera that makes no sense is refused before any work.
  static_cast<void>(make_camera(o.camera, views.front(), 0, box, o.width, o.height));

  const std::optional<HalfSpace> clip = clip_of(o, box);
  const Context quiet = without_progress(context);  // only the rays are reported
  std::vector<Drawn> drawn;
  for (const Subject& subject : subjects) drawn.push_back(drawn_of(subject, o, quiet));
  std::vector<Body> bodies = bodies_of(drawn, o, clip, quiet);
  const auto legend = colour(subjects, drawn, o, quiet, bodies);
  const Sheet sheet = sheet_of(o, views.size(), subjects.size(), legend);
  const std::vector<Camera> cameras = cameras_of(o, views, box, sheet.panel_width);
  if (o.camera.projection == Projection::perspective) refuse_cameras_inside(cameras, clip, bodies);
  const bool apart = sheet.a_model_a_column || sheet.a_model_a_row;
  const std::vector<Scene> scenes = scenes_of(std::move(bodies), drawn, o, clip, apart ? subjects.size() : 1);

  const double panels = 1.0 * sheet.columns * sheet.rows * std::max(1, o.turntable);
  double done = 0;
  Context part = context;
  if (context.progress)
    part.progress = [&](std::string_view stage, double fraction) { context.report(stage, (done + fraction) / panels); };
  std::vector<Image> frames;
  for (std::size_t first = 0; first < cameras.size(); first += views.size())
    frames.push_back(draw_frame({o, views, sheet, scenes, legend}, std::span(cameras).subspan(first, views.size()),
                                part, [&] { ++done; }));
  return frames;
}

}  // namespace spherule
