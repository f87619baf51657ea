// SPDX-License-Identifier: GPL-3.0-or-later
//
// Models -> simpler models. The map of this folder:
//   simplify    any method, and how far its result is from the object: the one header that most callers need
//   sphericity, splitting, prune, best   one method each
//   result      what all of them return: levels of detail, and the members of every sphere
//   object      the samples that results are measured against;  evaluate   the error
//   represent   one sphere in place of many
//   cover, frame, fit, together, ball_tree, ball_components, rows, distance, levels   what the methods are built of
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string_view>
#include <variant>

#include "core/base/context.h"
#include "core/base/option_texts.h"
#include "core/simplify/best.h"
#include "core/simplify/evaluate.h"
#include "core/simplify/prune.h"
#include "core/simplify/result.h"
#include "core/simplify/sphericity.h"
#include "core/simplify/splitting.h"

namespace spherule {

/// Changes whenever the same model would be simplified otherwise.
inline constexpr int simplify_edition = 3;

/// A method with its options.
using SimplifyMethod = std::variant<SphericityOptions, SplittingOptions, PruneOptions, BestOptions>;

struct Simplified {
  Simplification order;
  Achieved achieved;                     ///< of the last level
  std::optional<double> optimality_gap;  ///< as of BestSpheres
  double seconds = 0, evaluate_seconds = 0;
};

/// Runs a method and evaluates its last level against `object`. All but the seconds is a function of the other
/// arguments alone. Throws what check_method and the method throw, and unusable for an object without samples.
/// Reports the method's stage, then "evaluate".
Simplified simplify(const SphereModel& model, const SampledObject& object, const Reference& reference,
                    const SimplifyMethod& method, const Context& context = {});

/// Throws invalid_argument for options out of their bounds for a model of so many spheres, unusable for 0 spheres:
/// what the method itself would throw, before any work.
void check_method(const SimplifyMethod& method, std::size_t model_count);

// Methods in words: "method" is sphericity, median, average, prune or best; the other names are those of the options'
// members. Numbers are decimals, `buckets` are numbers with commas between.

/// Every name that some method has.
std::span<const std::string_view> method_option_names();
/// Throws invalid_argument, with a JSON pointer for each name that is unknown, given twice or not of this method, and
/// each value that is not of its kind. What check_method checks is left to it.
SimplifyMethod parse_method(const OptionTexts& given);
/// Every option that is set, defaults filled in, in one order: parse_method gives the method back.
OptionTexts method_texts(const SimplifyMethod& method);

}  // namespace spherule
