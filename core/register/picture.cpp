// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/picture.h"

#include <array>
#include <cmath>
#include <vector>

namespace spherule {

namespace {

// Whether the map takes balls to balls, to rounding.
bool is_similarity(const AffineMap& map) {
  const double squared_scale = scale_of(map) * scale_of(map);
  const Mat3 product = transposed(map.linear) * map.linear;
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b)
      if (!(std::abs(product.rows[static_cast<std::size_t>(a)][b] - (a == b ? squared_scale : 0)) <=
            1e-12 * squared_scale))
        return false;
  return true;
}

// Boxes around what the map makes of the patches.
std::vector<Patch> moved(std::span<const Patch> patches, const AffineMap& map) {
  std::vector<Patch> result;
  result.reserve(patches.size());
  for (const Patch& patch : patches) {
    const Vec3 centre = 0.5 * (patch.box.min + patch.box.max), half = 0.5 * (patch.box.max - patch.box.min);
    const Vec3 place = map(centre);
    Vec3 reach;
    for (int a = 0; a < 3; ++a) {
      const Vec3 row = map.linear.rows[static_cast<std::size_t>(a)];
      reach[a] =
          std::abs(row.x) * half.x + std::abs(row.y) * half.y + std::abs(row.z) * half.z + 1e-12 * std::abs(place[a]);
    }
    result.push_back({{place - reach, place + reach}, patch.ball});
  }
  return result;
}

}  // namespace

Image before_and_after(const SphereModel& fixed, const SphereModel& moving, const AffineMap& map,
                       const RenderOptions& options, const Context& context) {
  RenderOptions wanted = options;
  wanted.layout = Layout::overlaid;
  wanted.turntable = 0;
  const SphereModel still{.spheres = fixed.spheres, .solid = {}};
  SphereModel there{.spheres = moving.spheres, .solid = {}};
  // What models show is found sooner with the tetrahedra that they have.
  std::vector<Patch> still_patches, moving_patches;
  if (options.style == Style::spheres) {
    still_patches = visible_patches(fixed, context), moving_patches = visible_patches(moving, context);
  }
  const auto picture = [&](double from) {
    const std::array<Subject, 2> subjects{Subject{.model = &still, .patches = still_patches},
                                          Subject{.model = &there, .patches = moving_patches}};
    Context part = context;
    part.progress = [&, from](std::string_view stage, double fraction) {
      context.report(stage, from + 0.5 * fraction);
    };
    return render(subjects, wanted, part).front();
  };
  const Image before = picture(0);
  const double scale = scale_of(map);
  for (Sphere& ball : there.spheres) ball = {map(ball.centre), scale * ball.radius};
  moving_patches = is_similarity(map) ? moved(moving_patches, map) : std::vector<Patch>();
  const Image after = picture(0.5);
  Image both = blank_image(before.width + after.width, std::max(before.height, after.height));
  place(before, 0, 0, both);
  place(after, before.width, 0, both);
  return both;
}

}  // namespace spherule
