// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/picture.h"

#include <array>

namespace spherule {

Image before_and_after(const SphereModel& fixed, const SphereModel& moving, const AffineMap& map,
                       const RenderOptions& options, const Context& context) {
  RenderOptions wanted = options;
  wanted.layout = Layout::overlaid;
  wanted.turntable = 0;
  const SphereModel still{.spheres = fixed.spheres, .solid = {}};
  SphereModel moved{.spheres = moving.spheres, .solid = {}};
  const auto picture = [&](double from) {
    const std::array<Subject, 2> subjects{Subject{.model = &still}, Subject{.model = &moved}};
    Context part = context;
    part.progress = [&, from](std::string_view stage, double fraction) {
      context.report(stage, from + 0.5 * fraction);
    };
    return render(subjects, wanted, part).front();
  };
  const Image before = picture(0);
  const double scale = scale_of(map);
  for (Sphere& ball : moved.spheres) ball = {map(ball.centre), scale * ball.radius};
  const Image after = picture(0.5);
  Image both = blank_image(before.width + after.width, std::max(before.height, after.height));
  place(before, 0, 0, both);
  place(after, before.width, 0, both);
  return both;
}

}  // namespace spherule
