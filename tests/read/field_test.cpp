// SPDX-License-Identifier: GPL-3.0-or-later
//
// Small files after public bug reports, with the values that independent readers give (README of the shared data's
// folder `field`). The same properties are made in miniature in the tests of each format.
#include "core/inside.h"
#include "tests/read/files.h"

namespace spherule::test {
namespace {

namespace fs = std::filesystem;

class Field : public SharedFiles {
 protected:
  Field() : SharedFiles("field") {}
};

std::uint64_t at_least(const Volume& volume, double threshold) {
  ObjectRule rule;
  rule.lo = threshold;
  return classify_samples(volume, rule).inside.count();
}

std::uint64_t labelled(const Volume& volume, Label label) {
  ObjectRule rule;
  rule.kind = ObjectRule::Kind::labels;
  rule.labels = {label};
  return classify_samples(volume, rule).inside.count();
}

Vec3 last(const Volume& volume) {
  Vec3 mm;
  for (int a = 0; a < 3; ++a) mm[a] = (volume.grid.dims[static_cast<std::size_t>(a)] - 1) * volume.grid.spacing[a];
  return volume.grid.to_patient(mm);
}

TEST_F(Field, ScaledLabelMapsMatchTheirLabels) {
  const Volume volume = read({"02-labels-int16-scaled.nii"});
  EXPECT_EQ(labelled(volume, 1), 383U);
  EXPECT_EQ(labelled(volume, 2), 102U);
  EXPECT_EQ(labelled(volume, 3), 15U);
}

TEST_F(Field, NrrdUnitsOfLengthCount) {
  const Volume volume = read({"03-microns.nrrd"});
  expect_near(volume.grid.spacing, {0.00038, 0.00038, 0.00038}, 1e-12);
  EXPECT_EQ(at_least(volume, 60), 500U);
}

TEST_F(Field, FourDimensionsAsItkWritesThemAreASeries) {
  expect_refused(paths({"05-itk-4d.nrrd"}), ErrorCode::unusable);
  const Volume volume = read({"05-itk-4d.nrrd"}, {.frame = 1});
  EXPECT_EQ(volume.grid.dims, (std::array{22, 18, 14}));
  EXPECT_EQ(at_least(volume, 20), 849U);
}

TEST_F(Field, ListsOfLayersAreASeries) {
  const Volume volume = read({"06-two-layers.seg.nrrd"}, {.frame = 1});
  EXPECT_EQ(labelled(volume, 1), 117U);
  expect_near(last(volume), {32, 31, 22}, 1e-9);
}

TEST_F(Field, ADetachedHeaderOverANiftiFileIsOneVolume) {
  const Volume volume = read({"07-over-nifti.nhdr", "07-over.nii.gz"});
  EXPECT_EQ(volume.format, "nrrd");
  EXPECT_EQ(at_least(volume, 600), 500U);
  expect_near(last(volume), {32, 31, 22}, 1e-9);
}

TEST_F(Field, NotANumberIsOutside) {
  const Volume volume = read({"08-nan-around.nii"});
  EXPECT_EQ(at_least(volume, 60), 500U);
  EXPECT_TRUE(warns(volume, "not a finite number (NaN or infinite): outside"));
}

TEST_F(Field, AnSformOfOtherLengthsThanPixdimIsSaid) { EXPECT_TRUE(warns(read({"11-vinci.nii"}), "pixdim")); }

TEST_F(Field, TheQformStandsInForAnUnusableSform) {
  for (const char* name : {"12-zero-sform.nii", "12-nan-sform.nii"}) {
    const Volume volume = read({name});
    EXPECT_TRUE(warns(volume, "the qform")) << name;
    EXPECT_EQ(volume.grid.spacing, (Vec3{2, 3, 4}));
    expect_near(last(volume), {-32, -31, 22}, 1e-9);
    EXPECT_EQ(at_least(volume, 60), 500U);
  }
}

TEST_F(Field, NrrdEncodingsKeysAndMetaImageHeadersThatPeersRead) {
  for (const char* name :
       {"13-ascii.nrrd", "13-bzip2.nrrd", "15-colon-keys.nrrd", "21-comment-twice.mha", "21-keys-before-ndims.mha"}) {
    SCOPED_TRACE(name);
    const Volume volume = read({name});
    EXPECT_EQ(at_least(volume, 600), 500U);
    expect_near(last(volume), {32, 31, 22}, 1e-9);
    EXPECT_EQ(warns(volume, "do not matter"), std::string_view(name).starts_with("21"));
  }
}

TEST_F(Field, ThickSlicesAreSaid) {
  for (const char* name : {"17-spacing-1-1-30.mha", "17-spacing-1-1-1000.mha"}) {
    EXPECT_TRUE(warns(read({name}), "thick")) << name;
  }
}

TEST_F(Field, OdditiesThatLibniftiMendsAreMended) {
  Volume volume = read({"23-dim4-zero.nii"});
  EXPECT_EQ(at_least(volume, 60), 500U);
  EXPECT_FALSE(volume.warnings.empty());
  volume = read({"23-one-slice-pixdim3-zero.nii"});
  EXPECT_EQ(volume.grid.spacing, (Vec3{2, 3, 1}));
  EXPECT_TRUE(warns(volume, "pixdim"));
}

TEST_F(Field, WhatWasReadRightStaysSo) {
  expect_near(read({"P2-micron-qform.nii"}).grid.spacing, {0.4, 0.4, 0.4}, 1e-9);
  EXPECT_EQ(at_least(read({"P2-micron-qform.nii"}), 60), 500U);
  EXPECT_EQ(at_least(read({"P3-extension-flag-only.nii"}), 60), 500U);
  const Volume volume = read({"P5-4d-rotated.mha"}, {.frame = 1});
  expect_near(volume.grid.spacing, {0.857, 0.857, 3}, 1e-9);
  EXPECT_EQ(at_least(volume, 20), 849U);
}

}  // namespace
}  // namespace spherule::test
