// SPDX-License-Identifier: GPL-3.0-or-later
//
// Rays against things that have an inside. Private to core/render; trace.cpp is the only user of Embree.
//
// Embree walks a hierarchy of boxes in single precision; what a ray meets in a box is computed in double by the
// primitive. Boxes are grown by more than the walk can lose, and equal distances go to the smaller index, so an
// answer depends neither on how the hierarchy was built nor on the processor's vectors.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/render/colour.h"
#include "core/render/patches.h"

namespace spherule {

struct Ray {
  Vec3 origin;                                           ///< LPS mm
  Vec3 direction;                                        ///< of length 1
  double far = std::numeric_limits<double>::infinity();  ///< mm along the ray; what is beyond does not count
};

inline constexpr std::uint32_t no_primitive = 0xffffffffU;

struct Hit {
  double distance = 0;  ///< mm along the ray
  std::uint32_t primitive = no_primitive;
  Vec3 out{};  ///< of blobs: along the normal, as long as the field is steep
  explicit operator bool() const { return primitive != no_primitive; }
};

/// A point of a surface.
struct Place {
  Vec3 point;
  Vec3 normal;  ///< of length 1, towards the outside
  Vec3 start;   ///< where rays that leave the surface start
};

/// The points with normal · x <= offset; `normal` of length 1.
struct HalfSpace {
  Vec3 normal;
  double offset = 0;
  bool operator==(const HalfSpace&) const = default;
};

/// Immutable once made: any number of threads may ask at a time.
class Tracer {
 public:
  virtual ~Tracer() = default;

  /// Holds everything that can be met; empty when nothing can.
  virtual Box bounds() const = 0;
  /// For each ray, which must start outside, the first point where it enters. Fastest when neighbouring rays are
  /// alike.
  virtual void first_hits(std::span<const Ray> rays, std::span<Hit> hits) const = 0;
  /// Sets blocked[i] to whether ray i enters at all. `alike`: neighbouring rays have nearly one direction.
  virtual void blocked(std::span<const Ray> rays, std::span<std::uint8_t> blocked, bool alike) const = 0;
  /// Whether the point is inside.
  virtual bool inside(Vec3 point) const = 0;
  virtual Place place(const Ray& ray, const Hit& hit) const = 0;
  /// The colour there, from a table with one entry a primitive; of blended primitives, the blend.
  virtual Colour colour(Vec3 point, const Hit& hit, std::span<const Colour> table) const = 0;
  /// Mean curvature of the surface there, 1/mm: above 0 where it bulges out.
  virtual double curvature(Vec3 point, const Hit& hit) const = 0;
  /// Some curvatures of the surface, for a scale to hold them.
  virtual std::vector<double> typical_curvatures() const = 0;

  std::optional<Hit> first_hit(const Ray& ray) const;
  bool blocked(const Ray& ray) const;
};

/// The union of balls, of which only the patches can be met (patches.h); primitives are balls. `cut`: a plane on which
/// inside() is asked often: O(log) there, O(balls) elsewhere. Takes copies: 40 bytes a patch, and about as much again
/// for the boxes; `spheres` must outlive the tracer. O(patches log patches). Throws cancelled.
std::unique_ptr<const Tracer> trace_balls(std::span<const Sphere> spheres, std::span<const Patch> patches,
                                          const std::optional<HalfSpace>& cut, const Context& context);

/// A surface of triangles, vertices anticlockwise as seen from outside; primitives are triangles. `smooth`: normals
/// and colours change evenly between the vertices (the colour table has one entry a vertex), else each triangle has
/// its own. Triangles are met from both sides; inside() needs a closed surface. The spans must outlive the tracer.
/// O(triangles log triangles). Throws cancelled.
using Triangle = std::array<std::uint32_t, 3>;
std::unique_ptr<const Tracer> trace_facets(std::span<const Vec3> vertices, std::span<const Triangle> triangles,
                                           bool smooth, const Context& context);

/// Balls blended into each other over about blend_mm (above 0), see blobs.cpp; primitives are cells (blob_cells.h). The
/// spheres must outlive the tracer. About 3 kB a ball, and up to 64 MiB where few end in one place. Throws cancelled.
std::unique_ptr<const Tracer> trace_blobs(std::span<const Sphere> spheres, double blend_mm, const Context& context);

// What the tracers are made of.

/// Up to 16 rays on their way.
struct Lanes {
  static constexpr std::size_t most = 16;
  alignas(64) std::array<double, most> ox, oy, oz, dx, dy, dz;
  alignas(64) std::array<double, most> far;               ///< nearest hit so far, or the ray's limit
  alignas(64) std::array<std::uint32_t, most> primitive;  ///< of that hit
  /// Takes the first rays of a list, up to 16, and says how many; lanes beyond repeat the last.
  std::size_t load(std::span<const Ray> rays);
};

/// What is in the boxes of a hierarchy.
class Primitives {
 public:
  virtual ~Primitives() = default;
  virtual std::size_t size() const = 0;
  virtual Box box(std::size_t index) const = 0;
  /// For lanes [begin, end) with valid[lane] != 0 that meet content `index` before `far`: shortens `far` and sets
  /// `primitive`. Returns these lanes as bits.
  virtual std::uint32_t meet(std::uint32_t index, Lanes& lanes, const int* valid, std::size_t begin,
                             std::size_t end) const = 0;
};

/// Boxes that rays can be asked for.
class Hierarchy {
 public:
  /// `primitives` must outlive it. Throws cancelled.
  Hierarchy(const Primitives& primitives, const Context& context);
  ~Hierarchy();
  Hierarchy(const Hierarchy&) = delete;
  Hierarchy& operator=(const Hierarchy&) = delete;

  /// What Tracer asks of a set of primitives.
  void first_hits(std::span<const Ray> rays, std::span<Hit> hits) const;
  void blocked(std::span<const Ray> rays, std::span<std::uint8_t> blocked, bool alike) const;

  /// Meets what may be nearer than each ray's `far`, for lanes [0, count).
  void nearest(Lanes& lanes, std::size_t count, bool alike) const;
  /// The same until something is met.
  void any(Lanes& lanes, std::size_t count, bool alike) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace spherule
