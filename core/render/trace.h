// SPDX-License-Identifier: GPL-3.0-or-later
//
// Rays against a union of balls. Private to core/render.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/render/patches.h"

namespace spherule {

struct Ray {
  Vec3 origin;     ///< LPS mm
  Vec3 direction;  ///< of length 1
};

struct Hit {
  double distance = 0;  ///< mm along the ray, in double precision
  std::uint32_t ball = 0;
};

/// A bounding volume hierarchy over patches. Immutable once made: any number of threads may ask at a time.
class Tracer {
 public:
  /// Takes copies: 40 bytes a patch, and about as much again for the boxes. O(patches log patches). Throws cancelled.
  Tracer(std::span<const Sphere> spheres, std::span<const Patch> patches, const Context& context);
  ~Tracer();
  Tracer(const Tracer&) = delete;
  Tracer& operator=(const Tracer&) = delete;

  /// The first point where the ray, which must start outside every ball, enters one. At equal distances the ball with
  /// the smallest index wins, so the answer does not depend on how the hierarchy was built.
  std::optional<Hit> first_hit(const Ray& ray) const;
  /// Whether the ray enters a ball at all.
  bool blocked(const Ray& ray) const;

 private:
  struct Scene;
  std::unique_ptr<const Scene> scene_;
};

}  // namespace spherule
