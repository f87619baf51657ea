// SPDX-License-Identifier: GPL-3.0-or-later
//
// ITK itself reads the file that we write for it.
#include "core/register/itk.h"

#include <gtest/gtest.h>
#include <itkAffineTransform.h>
#include <itkTransformFactory.h>
#include <itkTransformFileReader.h>
#include <itkTxtTransformIOFactory.h>

#include <filesystem>
#include <fstream>

#include "tests/core/register/poses.h"

namespace spherule {
namespace {

TEST(ItkTransform, ItkReadsItAndMapsPointsTheSame) {
  itk::TxtTransformIOFactory::RegisterOneFactory();
  itk::TransformFactory<itk::AffineTransform<double, 3>>::RegisterTransform();
  const auto file = std::filesystem::path(testing::TempDir()) / "spherule-itk-transform-test.tfm";
  phantoms::Random random(1);
  for (int t = 0; t < 5; ++t) {
    AffineMap map{scaled(0.3 + random.unit(), poses::random_rotation(random)), poses::within_cube(random, 500)};
    for (Vec3& row : map.linear.rows) row = row + poses::within_cube(random, 0.2);
    std::ofstream(file, std::ios::binary) << itk_transform(map);
    const auto reader = itk::TransformFileReaderTemplate<double>::New();
    reader->SetFileName(file.string());
    reader->Update();
    ASSERT_EQ(reader->GetTransformList()->size(), 1U);
    const auto* transform =
        dynamic_cast<const itk::Transform<double, 3, 3>*>(reader->GetTransformList()->front().GetPointer());
    ASSERT_NE(transform, nullptr);
    for (int s = 0; s < 20; ++s) {
      const Vec3 p = poses::within_cube(random, 400), ours = map(p);
      const double from[3] = {p.x, p.y, p.z};
      const auto theirs = transform->TransformPoint(itk::Point<double, 3>(from));
      EXPECT_LT(norm(Vec3{theirs[0], theirs[1], theirs[2]} - ours), 1e-10);
    }
  }
  std::filesystem::remove(file);
}

}  // namespace
}  // namespace spherule
