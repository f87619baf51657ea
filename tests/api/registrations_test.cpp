// SPDX-License-Identifier: GPL-3.0-or-later
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "api/json/registration_documents.h"
#include "api/paths.h"
#include "api/routes.h"
#include "tests/api/stub.h"
#include "tests/contract/contract.h"

namespace spherule::test {
namespace {

using Json = nlohmann::json;

const std::string kPath = "/v1/registrations/" + kRegistration;
const std::string kPair = R"("fixed": ")" + kModel + R"(", "moving": ")" + kImported + R"(")";

class Registrations : public testing::Test {
 protected:
  // Asks, and holds every answer against the contract.
  api::Response ask(const std::string& method, const std::string& target, const std::string& text = {},
                    std::vector<std::pair<std::string, std::string>> headers = {}) {
    StubBody body(text);
    api::Request request{.method = method, .path = target.substr(0, target.find('?')), .id = "req_1", .body = &body};
    request.headers = std::move(headers);
    if (const std::size_t at = target.find('?'); at != std::string::npos) {
      const std::string query = target.substr(at + 1);
      request.query.emplace_back(query.substr(0, query.find('=')), query.substr(query.find('=') + 1));
    }
    api::Response response = api::handle(service, request);
    const auto* whole = std::get_if<std::string>(&response.body);
    std::string bytes = whole != nullptr ? *whole : "";
    for (const std::string& wrong :
         violations(method, request.path, response.status, response.header("Content-Type"), bytes)) {
      ADD_FAILURE() << wrong;
    }
    return response;
  }
  static Json body_of(const api::Response& response) { return Json::parse(std::get<std::string>(response.body)); }

  StubService service;
};

TEST_F(Registrations, AreMadeWithDefaultsFilledIn) {
  service.already_stored = false;
  const api::Response made = ask("POST", "/v1/registrations", "{" + kPair + "}", {{"Prefer", "wait=5"}});
  EXPECT_EQ(made.status, 201);
  EXPECT_EQ(made.header("Location"), kPath);
  EXPECT_EQ(made.header("Preference-Applied"), "wait=5");
  ASSERT_TRUE(service.registered);
  EXPECT_EQ(service.registered->options.k, 64U);
  EXPECT_EQ(service.registered->options.transform, TransformKind::similarity);
  EXPECT_EQ(service.waited, 5);
  service.already_stored = true;
  EXPECT_EQ(ask("POST", "/v1/registrations", "{" + kPair + "}").status, 200);
  service.finished = false;
  EXPECT_EQ(ask("POST", "/v1/registrations", "{" + kPair + "}").status, 202);
}

TEST_F(Registrations, EveryOptionArrives) {
  const std::string wish = "{" + kPair +
                           R"(, "transform": "affine", "method": "matching", "k": 16, "inits": 8, "seed": 3,
                             "refine": false, "scale_bounds": [0.5, 2], "weights": {"position": 2, "alone": 0.25}})";
  EXPECT_EQ(ask("POST", "/v1/registrations", wish).status, 200);
  ASSERT_TRUE(service.registered);
  // Through the record and back, which is what jobs see.
  const auto r =
      std::get<api::RegistrationRequest>(api::work_from("registration", api::record_of(*service.registered)));
  EXPECT_EQ(r.fixed, kModel);
  EXPECT_EQ(r.moving, kImported);
  EXPECT_EQ(r.options.transform, TransformKind::affine);
  EXPECT_EQ(r.options.method, RegistrationMethod::matching);
  EXPECT_EQ(r.options.k, 16U);
  EXPECT_EQ(r.options.inits, 8U);
  EXPECT_EQ(r.options.seed, 3U);
  EXPECT_FALSE(r.options.refine);
  EXPECT_EQ(r.options.min_scale, 0.5);
  EXPECT_EQ(r.options.max_scale, 2);
  EXPECT_EQ(r.options.weights.position, 2);
  EXPECT_EQ(r.options.weights.size, MatchingWeights{}.size);
  EXPECT_EQ(r.options.weights.alone, 0.25);
  EXPECT_EQ(api::record_of(r), api::record_of(*service.registered));
  api::RegistrationRequest other = r;
  other.options.seed = 4;
  EXPECT_NE(api::identity_of(r, "1"), api::identity_of(other, "1"));
  EXPECT_NE(api::identity_of(r, "1"), api::identity_of(r, "2"));
}

TEST_F(Registrations, BadWishesAreRefusedByName) {
  for (const auto& [wish, pointer] :
       std::vector<std::pair<std::string, std::string>>{{R"("k": 3)", "/k"},
                                                        {R"("k": "many")", "/k"},
                                                        {R"("inits": 0)", "/inits"},
                                                        {R"("transform": "rubber")", "/transform"},
                                                        {R"("method": "guess")", "/method"},
                                                        {R"("scale_bounds": [2, 1])", "/scale_bounds"},
                                                        {R"("scale_bounds": 2)", "/scale_bounds"},
                                                        {R"("weights": {"colour": 1})", "/weights/colour"},
                                                        {R"("weights": {"size": -1})", "/weights"},
                                                        {R"("weights": 7)", "/weights"},
                                                        {R"("seed": -1)", "/seed"},
                                                        {R"("refine": 1)", "/refine"},
                                                        {R"("rotation": 1)", "/rotation"}}) {
    const api::Response refused = ask("POST", "/v1/registrations", "{" + kPair + ", " + wish + "}");
    EXPECT_EQ(refused.status, 400) << wish;
    EXPECT_EQ(body_of(refused)["errors"][0]["pointer"], pointer);
  }
  EXPECT_EQ(body_of(ask("POST", "/v1/registrations", "{}"))["errors"].size(), 2U);
  EXPECT_EQ(ask("POST", "/v1/registrations", "[]").status, 400);
  EXPECT_EQ(ask("POST", "/v1/registrations", R"({"fixed": "mdl_x", "moving": "mdl_y"})").status, 404);
  EXPECT_EQ(ask("GET", kPath + "?format=xml").status, 400);
  EXPECT_EQ(ask("GET", kPath + "/render?turntable=5").status, 400);
  EXPECT_EQ(ask("GET", kPath + "/render?with=" + kModel).status, 400);
  EXPECT_EQ(ask("GET", kPath + "/render?width=8000").status, 413);
  EXPECT_EQ(ask("POST", kPath + "/apply", R"({"what": "nothing"})").status, 400);
  EXPECT_EQ(ask("POST", kPath + "/apply", R"({"which": "model"})").status, 400);
  EXPECT_EQ(ask("GET", "/v1/registrations/reg_" + std::string(32, '0')).status, 404);
}

TEST_F(Registrations, SayAllOfIt) {
  const Json json = body_of(ask("GET", kPath));
  EXPECT_EQ(json["id"], kRegistration);
  EXPECT_EQ(json["moving_to_fixed"][3], Json({0, 0, 0, 1}));
  EXPECT_EQ(json["moving_to_fixed"][2], Json({0.0, 0.0, 2.0, 3.0}));
  EXPECT_NEAR(json["decomposition"]["scale"].get<double>(), 2, 1e-12);
  EXPECT_NEAR(json["decomposition"]["angle_deg"].get<double>(), 180 / 3.14159265358979, 1e-9);
  EXPECT_EQ(json["pairs"], Json({{0, 1}}));
  EXPECT_EQ(json["parameters"]["k"], 8);
  EXPECT_EQ(json["other_poses"].size(), 1U);
  EXPECT_EQ(json["links"]["fixed"], "/v1/models/" + kModel);
  const Json list = body_of(ask("GET", "/v1/registrations"));
  EXPECT_EQ(list["registrations"].size(), 1U);
  EXPECT_FALSE(list["registrations"][0].contains("pairs"));
  EXPECT_EQ(list["next_cursor"], "next");

  const api::Response itk = ask("GET", kPath + "?format=itk");
  EXPECT_EQ(itk.header("Content-Type"), "text/plain");
  EXPECT_TRUE(std::get<std::string>(itk.body).starts_with("#Insight Transform File V1.0\n"));
  EXPECT_EQ(ask("DELETE", kPath).status, 204);
  EXPECT_EQ(service.deleted, std::vector<std::string>{kRegistration});
}

TEST_F(Registrations, PicturesAndResampledVolumesAreDerived) {
  service.image_pixels = 2'000'000;
  EXPECT_EQ(ask("GET", kPath + "/render?of=spheres").header("Content-Type"), "image/png");
  ASSERT_TRUE(service.derived);
  const auto through = [&] {
    return std::get<api::DerivedRequest>(api::work_from("registration_answer", api::record_of(*service.derived)));
  };
  EXPECT_TRUE(std::get<api::BeforeAfterRequest>(through().what).few);
  EXPECT_EQ(api::path_of(through(), {}), kPath + "/render?of=spheres");
  EXPECT_EQ(ask("POST", kPath + "/apply").header("Content-Type"), "application/x-nifti");
  EXPECT_EQ(std::get<api::AppliedRequest>(through().what).what, api::Applied::volume);
  EXPECT_EQ(ask("POST", kPath + "/apply", R"({"what": "model"})").status, 200);
  EXPECT_EQ(std::get<api::AppliedRequest>(through().what).what, api::Applied::model);
  EXPECT_EQ(api::path_of(through(), {}), kPath + "/apply?what=model");
  EXPECT_EQ(ask("GET", kPath + "/apply?what=model").status, 200);
  service.finished = false;
  EXPECT_EQ(ask("GET", kPath + "/apply?what=volume").status, 202);
}

}  // namespace
}  // namespace spherule::test
