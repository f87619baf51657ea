// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/itk.h"

#include "core/base/text.h"

namespace spherule {

std::string itk_transform(const AffineMap& map) {
  std::string text = "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\nParameters:";
  const auto add = [&](double value) { text += ' ' + text_of(value); };
  for (const Vec3& row : map.linear.rows) add(row.x), add(row.y), add(row.z);
  add(map.shift.x), add(map.shift.y), add(map.shift.z);
  // The centre: with it at the origin the translation is the shift.
  return text + "\nFixedParameters: 0 0 0\n";
}

}  // namespace spherule
