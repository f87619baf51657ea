// SPDX-License-Identifier: GPL-3.0-or-later
//
// Two models -> the transform that lays one on the other. The map of this folder:
//   transform  maps of space, and their parts          solve       points and partners -> map (Umeyama)
//   rotations  evenly spread rotations                 assignment  who goes with whom at the least cost
//   shape      model -> what registration looks at     overlap     soft balls over all poses
//   matching   spheres -> pairs -> map (the paper)     surface_fit surface onto surface
//   quality    overlap of unions                       itk         map -> file
//   resample   moving volume or model on the fixed grid
//   picture    before and after
//
// Sources: Ranjan and Fournier, Volume Models for Volumetric Data (1994), section 4; the others are named where they
// are used.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/base/context.h"
#include "core/pipeline.h"
#include "core/register/matching.h"
#include "core/register/quality.h"
#include "core/register/solve.h"
#include "core/register/surface_fit.h"
#include "core/register/transform.h"
#include "core/spheres.h"

namespace spherule {

enum class RegistrationMethod : std::uint8_t {
  /// All rotations are tried on soft balls, the best are climbed from, and the surfaces decide.
  global,
  /// The paper's: spheres are matched at the least cost, from the pose that matching by size and shape alone gives, the
  /// four poses of the principal axes and a few evenly spread ones; the transform is that of the pairs.
  matching,
};

struct RegistrationOptions {
  TransformKind transform = TransformKind::similarity;
  RegistrationMethod method = RegistrationMethod::global;
  std::uint32_t k = 64;                     ///< spheres that each model is simplified to; 4 … 512
  std::uint32_t inits = 32;                 ///< starts that are followed to their end; 1 … 256
  double min_scale = 0.05, max_scale = 20;  ///< of the answer, moving to fixed; not for rigid
  MatchingWeights weights{};
  bool refine = true;      ///< by the models' surfaces; without it the answer is that of the k spheres
  std::uint64_t seed = 0;  ///< turns the rotations that are tried; any answer that depends on it is in doubt
};

/// Changes whenever the same models and options would give another answer.
inline constexpr int registration_edition = 3;

/// Throws invalid_argument, naming the field, for options outside their ranges.
void check_registration_options(const RegistrationOptions& options);

struct FoundPose {
  AffineMap moving_to_fixed;  ///< LPS mm
  SurfaceDistance surfaces;   ///< in that pose
};

struct Registration {
  AffineMap moving_to_fixed;  ///< LPS mm
  Vec3 centre;                ///< of the moving model: about which the transform is told in parts

  UnionOverlap overlap;          ///< of the models; exact where both are few spheres and the map is no affine
  UnionOverlap spheres_overlap;  ///< of the k and k spheres, exact (under an affine map: of balls of equal volume)
  SurfaceDistance surfaces;      ///< `within`: of reach_mm
  double reach_mm = 0;
  double matched_share = 0;    ///< of both volumes, in matched spheres
  double residual_rms_mm = 0;  ///< of the centres of matched spheres

  std::vector<Sphere> fixed_spheres, moving_spheres;  ///< the k spheres of each, each where it was
  std::vector<SpherePair> pairs;                      ///< ascending by moving sphere
  double radius_ratio = 1;                            ///< the paper's estimate of the scale

  std::vector<FoundPose>
      others;  ///< other poses nearly as good, the best first: those of a symmetric object. None when poor
  /// Less than three quarters of one of the surfaces lie within reach_mm of the other: the models may be of different
  /// objects, or of parts of one that overlap little. A warning says so.
  bool poor = false;
  std::vector<StageTime> timings;
  std::vector<std::string> warnings;  ///< sentences for the user
};

/// The transform T that takes the moving model onto the fixed one, for any pose, scale and resolution of either. Volume
/// and second moments of the models give the scale (affine: all but a rotation), their centroids the shift; then the
/// rotation is looked for among thousands, by the overlap of k soft balls, and the best `inits` are refined by overlap
/// and by surfaces, robustly, so that what one model lacks does not pull. A function of models and options alone. Less
/// than half a second for models of 100,000 spheres, a good part of it independent of the models' size. Throws what
/// check_registration_options does; unusable for a model without volume, and for models so unlike in size or so flat
/// that no map between them can be told in numbers: what is returned can be undone and decomposed. 120 bytes a sphere
/// or cell of either model beside them, and 10 MB. Reports stage "register".
Registration register_models(const SphereModel& fixed, const SphereModel& moving,
                             const RegistrationOptions& options = {}, const Context& context = {});

}  // namespace spherule
