// SPDX-License-Identifier: GPL-3.0-or-later
//
// What the catalogue keeps of things: one line of JSON each. `x_from(record_of(x))` is x; what reads throws corrupt for
// text that record_of did not write, and record_of throws unusable for figures that are not finite.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "api/things.h"

namespace spherule::api {

/// Of a volume.
std::string record_of(const VolumeInfo& volume);
VolumeInfo volume_from(std::string_view record);

/// Of a model.
std::string record_of(const ModelInfo& model);
ModelInfo model_from(std::string_view record);

/// Counts of a volume's values.
std::string record_of(std::span<const std::uint64_t> counts);
std::vector<std::uint64_t> counts_from(std::string_view record);

}  // namespace spherule::api
