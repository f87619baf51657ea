// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/itk.h"

#include <array>
#include <charconv>

namespace spherule {

std::string itk_transform(const AffineMap& map) {
  std::string text = "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\nParameters:";
  const auto add = [&](double value) {
    std::array<char, 32> digits{};
    text += " ";
    text.append(digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), value + 0.0).ptr);
  };
  for (const Vec3& row : map.linear.rows) add(row.x), add(row.y), add(row.z);
  add(map.shift.x), add(map.shift.y), add(map.shift.z);
  // The centre: with it at the origin the translation is the shift.
  return text + "\nFixedParameters: 0 0 0\n";
}

}  // namespace spherule
