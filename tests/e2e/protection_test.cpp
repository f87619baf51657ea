// SPDX-License-Identifier: GPL-3.0-or-later
//
// Keys, TLS, and what logs tell and do not tell.
#include <gtest/gtest.h>
#include <httplib.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

namespace fs = std::filesystem;

const std::string kRaw = "?format=raw&dims=20,20,20&dtype=uint8";

std::string contents(const fs::path& path) {
  std::ostringstream text;
  text << std::ifstream(path).rdbuf();
  return text.str();
}

Ask with(const std::string& token, const std::string& body = {}) {
  return {.headers = {{"Authorization", "Bearer " + token}}, .body = body, .type = body.empty() ? "" : "text/plain"};
}

TEST(Keys, DecideWhoMayDoWhat) {
  const TemporaryFolder folder;
  const Key reader = make_key("reader", "read"), writer = make_key("writer", "write"), admin = make_key("ops", "admin");
  const fs::path config = folder.path() / "spherule.toml";
  std::ofstream(config) << "# Three clients.\nkeys = [\"" << reader.entry << "\", \"" << writer.entry << "\", \""
                        << admin.entry << "\"]\n";
  const ServerProcess server(folder.path() / "data", {"--config", config.string()});
  const Client client(server.port());

  const Answer refused = client.get("/v1/volumes");
  EXPECT_EQ(refused.status, 401);
  EXPECT_EQ(refused.header("WWW-Authenticate"), "Bearer realm=\"spherule\"");
  EXPECT_EQ(refused.json()["type"], "urn:spherule:problem:unauthorized");
  EXPECT_EQ(client.get("/v1/volumes", with(writer.token + "0")).status, 401);
  for (const char* open : {"/livez", "/readyz", "/openapi.yaml", "/docs"}) EXPECT_EQ(client.get(open).status, 200);

  EXPECT_EQ(client.get("/v1/volumes", with(reader.token)).status, 200);
  const Answer forbidden = client.post("/v1/volumes" + kRaw, with(reader.token, ball(20, 9)));
  EXPECT_EQ(forbidden.status, 403);
  EXPECT_NE(forbidden.json()["detail"].get<std::string>().find("scope write"), std::string::npos);
  const Answer stored = client.post("/v1/volumes" + kRaw, with(writer.token, ball(20, 9)));
  ASSERT_EQ(stored.status, 201);
  const std::string id = stored.json()["id"];
  EXPECT_EQ(client.ask("DELETE", "/v1/volumes/" + id, with(writer.token)).status, 403);
  EXPECT_EQ(client.get("/v1/volumes/" + id, with(reader.token)).status, 200);
  EXPECT_EQ(client.ask("DELETE", "/v1/volumes/" + id, with(admin.token)).status, 204);

  const std::string audit = contents(folder.path() / "data" / "audit.log");
  EXPECT_NE(audit.find("\"who\":\"writer\",\"action\":\"POST /v1/volumes\",\"object\":\"" + id +
                       "\",\"outcome\":\"allowed\",\"status\":201"),
            std::string::npos)
      << audit;
  EXPECT_NE(audit.find("\"who\":\"ops\",\"action\":\"DELETE /v1/volumes/{volume}\",\"object\":\"" + id +
                       "\",\"outcome\":\"allowed\",\"status\":204"),
            std::string::npos);
  EXPECT_NE(audit.find("\"who\":\"writer\",\"action\":\"DELETE /v1/volumes/{volume}\",\"object\":\"" + id +
                       "\",\"outcome\":\"denied\""),
            std::string::npos);
  for (const Key* key : {&reader, &writer, &admin}) {
    EXPECT_EQ(audit.find(key->token), std::string::npos);
    EXPECT_EQ(server.log().find(key->token), std::string::npos);
  }
}

TEST(Keys, AreNeededBeyondLoopback) {
  const TemporaryFolder folder;
  const Ended refused = run_spheruled({"--host", "0.0.0.0", "--port", "0", "--data", folder.path() / "data"});
  EXPECT_EQ(refused.status, 1);
  EXPECT_NE(refused.output.find("loopback"), std::string::npos);
  EXPECT_FALSE(fs::exists(folder.path() / "data"));
  const ServerProcess server(folder.path() / "data", {"--host", "0.0.0.0", "--keys", make_key("a", "read").entry});
  EXPECT_EQ(Client(server.port()).get("/livez").status, 200);
}

TEST(Places, FromWherePagesMayNotCome) {
  const TemporaryFolder folder;
  const ServerProcess server(folder.path() / "data",
                             {"--hosts", "scans.example", "--cors-origins", "https://viewer.example"});
  const Client client(server.port());
  const auto status = [&](const std::string& method, const std::string& headers) {
    const std::string body = ball(20, 9);
    const std::string length = method == "GET" ? "" : "Content-Length: " + std::to_string(body.size()) + "\r\n";
    const std::string answer =
        client.raw(method + " /v1/volumes" + (method == "GET" ? "" : kRaw) + " HTTP/1.1\r\n" + headers + length +
                   "Connection: close\r\n\r\n" + (length.empty() ? "" : body));
    return answer.substr(std::min<std::size_t>(9, answer.size()), 3);
  };
  const std::string own = "Host: localhost:" + std::to_string(server.port()) + "\r\n";
  EXPECT_EQ(status("GET", own), "200");
  EXPECT_EQ(status("GET", "Host: scans.example\r\n"), "200");
  EXPECT_EQ(status("GET", "Host: evil.example\r\n"), "403") << "a name of a page that leads here";
  EXPECT_EQ(status("POST", own + "Origin: https://evil.example\r\n"), "403");
  EXPECT_EQ(status("POST", own + "Sec-Fetch-Site: cross-site\r\n"), "403");
  EXPECT_EQ(status("GET", own), "200");
  EXPECT_TRUE(client.get("/v1/volumes").json()["volumes"].empty()) << "nothing was stored";
  EXPECT_EQ(status("POST", own + "Origin: https://viewer.example\r\nSec-Fetch-Site: cross-site\r\n"), "201");
  EXPECT_EQ(status("POST", own), "200") << "curl";
  EXPECT_EQ(run_spheruled({"--check-config", "--hosts", "a b"}).status, 1);
}

TEST(Tls, ServesHttpsWithItsCertificate) {
  const TemporaryFolder folder;
  const std::string certificate = folder.path() / "cert.pem", key = folder.path() / "key.pem";
  const std::string make =
      "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj "
      "/CN=localhost -addext subjectAltName=IP:127.0.0.1,DNS:localhost -keyout " +
      key + " -out " + certificate + " 2>&1";
  ASSERT_EQ(std::system(make.c_str()), 0);
  const ServerProcess server(folder.path() / "data", {"--tls-certificate", certificate, "--tls-key", key});
  httplib::SSLClient client("localhost", server.port());
  client.set_ca_cert_path(certificate.c_str());
  const auto alive = client.Get("/livez");
  ASSERT_TRUE(alive) << httplib::to_string(alive.error());
  EXPECT_EQ(alive->status, 200);
  httplib::SSLClient distrustful("localhost", server.port());
  EXPECT_FALSE(distrustful.Get("/livez")) << "a certificate that nobody trusts";
  EXPECT_EQ(Client(server.port()).raw("GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n").find("200"), std::string::npos);

  std::ofstream(key) << "no key";
  const Ended refused = run_spheruled(
      {"--port", "0", "--data", folder.path() / "data2", "--tls-certificate", certificate, "--tls-key", key});
  EXPECT_EQ(refused.status, 1);
  EXPECT_NE(refused.output.find("certificate and key"), std::string::npos) << refused.output;
}

// A scan whose header, file names, query and headers name a patient: stored as it is, and told to nobody.
TEST(Logs, NeverNameAPatient) {
  const TemporaryFolder folder;
  const std::string patient = "DOE^JANE";
  ServerProcess server(folder.path() / "data");
  const Client client(server.port());
  std::string nifti = ball_nifti(20, 9, 1);
  nifti.replace(148, patient.size(), patient);  // descrip
  nifti.replace(228, patient.size(), patient);  // aux_file
  const std::map<std::string, std::string> telling = {
      {"User-Agent", patient}, {"Referer", "http://x/" + patient}, {"X-Request-Id", patient}, {"traceparent", patient}};
  std::string errors;
  const auto ask = [&](const std::string& method, const std::string& target, Ask what) {
    what.headers.insert(telling.begin(), telling.end());
    const Answer answer = client.ask(method, target, what);
    if (answer.status >= 400) errors += answer.body;
    for (const auto& [name, value] : answer.headers) errors += name + value;
    return answer;
  };
  const Answer stored = ask("POST", "/v1/volumes", {.body = nifti, .type = "application/octet-stream"});
  ASSERT_EQ(stored.status, 201);
  const std::string id = stored.json()["id"];
  EXPECT_EQ(ask("POST", "/v1/models",
                {.headers = {{"Prefer", "wait=30"}}, .body = Json{{"volume", id}, {"threshold", 60.5}}.dump()})
                .status,
            201);
  EXPECT_EQ(ask("GET", "/v1/volumes/" + id + "/content", {}).body, nifti);
  const auto part = [&](const std::string& name, const std::string& bytes) {
    return "--b\r\nContent-Disposition: form-data; name=\"file\"; filename=\"" + name + "\"\r\n\r\n" + bytes + "\r\n";
  };
  const std::string multipart = "multipart/form-data; boundary=b";
  const std::string files =
      part(patient + ".hdr", nifti.substr(0, 348)) + part(patient + ".img", "short") + "--b--\r\n";
  EXPECT_GE(ask("POST", "/v1/volumes", {.body = files, .type = multipart}).status, 400);
  EXPECT_GE(ask("POST", "/v1/volumes", {.body = patient + " is no scan", .type = "text/plain"}).status, 400);
  EXPECT_EQ(ask("GET", "/v1/volumes/DOE%5EJANE", {}).status, 404);
  EXPECT_EQ(ask("GET", "/v1/DOE%5EJANE", {}).status, 404);
  EXPECT_EQ(server.terminate(), 0);

  const std::string log = server.log(), audit = contents(folder.path() / "data" / "audit.log");
  EXPECT_NE(log.find("\"route\":\"/v1/volumes\""), std::string::npos);
  EXPECT_NE(log.find("\"event\":\"job\""), std::string::npos);
  EXPECT_NE(audit.find(id), std::string::npos);
  for (const std::string& text : {log, audit, errors}) {
    EXPECT_EQ(text.find("DOE"), std::string::npos) << text;
    EXPECT_EQ(text.find("JANE"), std::string::npos) << text;
  }
  std::istringstream lines(log + audit);
  for (std::string line; std::getline(lines, line);) EXPECT_TRUE(Json::accept(line)) << line;
}

TEST(Logs, CarryTheTraceOfTheCaller) {
  const TemporaryFolder folder;
  ServerProcess server(folder.path() / "data");
  const std::string trace = "4bf92f3577b34da6a3ce929d0e0e4736";
  const Answer answer =
      Client(server.port()).get("/v1/volumes", {.headers = {{"traceparent", "00-" + trace + "-00f067aa0ba902b7-01"}}});
  EXPECT_EQ(server.terminate(), 0);
  EXPECT_NE(server.log().find("\"request\":\"" + answer.header("X-Request-Id") + "\""), std::string::npos);
  EXPECT_NE(server.log().find("\"trace\":\"" + trace + "\""), std::string::npos);
}

TEST(Memory, DecidesWhichWorkIsTaken) {
  const TemporaryFolder folder;
  const ServerProcess server(folder.path() / "data", {"--job-memory-bytes", "1M"});
  const Client client(server.port());
  const std::string small = client.upload(kRaw, ball(20, 9));
  EXPECT_EQ(client.model({{"volume", small}, {"threshold", 60.5}})["kind"], "raw");
  const std::string large = client.upload("?format=raw&dims=48,48,48&dtype=uint8", ball(48, 23));
  // Its samples fit; that its boundary points do not is known once they are counted.
  const Answer refused = client.post(
      "/v1/models", {.headers = {{"Prefer", "wait=60"}}, .body = Json{{"volume", large}, {"threshold", 60.5}}.dump()});
  EXPECT_EQ(refused.status, 422);
  EXPECT_NE(refused.json()["detail"].get<std::string>().find("MiB of memory, and this server has 1 MiB"),
            std::string::npos)
      << refused.body;
}

// By the header, before samples are read or unpacked; and small ones still come through.
TEST(Memory, DecidesWhichUploadsAreRead) {
  const TemporaryFolder folder;
  const ServerProcess server(folder.path() / "data", {"--job-memory-bytes", "1M"});
  const Client client(server.port());
  const auto refused = [&](const Answer& answer) {
    EXPECT_EQ(answer.status, 422) << answer.body;
    EXPECT_NE(answer.json().value("detail", "").find("MiB of memory, and this server has 1 MiB"), std::string::npos)
        << answer.body;
  };
  const std::string zeros(std::size_t{120} * 120 * 120, '\0');
  refused(client.post("/v1/volumes?format=raw&dims=120,120,120&dtype=uint8",
                      {.body = zeros, .type = "application/octet-stream"}));
  refused(client.post("/v1/volumes", {.body = ball_nifti(110, 50, 1), .type = "application/octet-stream"}));
  std::string rows = "x,y,z,r\n";
  for (int i = 0; i < 20'000; ++i) rows += "1,2,3,4\n";
  refused(client.post("/v1/models", {.body = rows, .type = "text/csv"}));
  EXPECT_EQ(client.get("/v1/volumes").json()["volumes"].size(), 0U);
  client.upload(kRaw, ball(20, 9));
}

// What was made under a larger budget is not read for a page of it under one that it does not fit.
TEST(Memory, DecidesWhichModelsAreRead) {
  const TemporaryFolder folder;
  std::string path;
  {
    ServerProcess server(folder.path() / "data");
    std::string rows = "x,y,z,r\n";
    for (int i = 0; i < 20'000; ++i) rows += std::to_string(i) + ",2,3,4\n";
    path = "/v1/models/" +
           Client(server.port()).post("/v1/models", {.body = rows, .type = "text/csv"}).json().value("id", "");
    EXPECT_EQ(Client(server.port()).get(path + "/spheres?limit=1").status, 200);
    EXPECT_EQ(server.terminate(), 0);
  }
  const ServerProcess server(folder.path() / "data", {"--job-memory-bytes", "1M"});
  const Client client(server.port());
  for (const char* what : {"/spheres?limit=1", "/histogram"}) {
    const Answer refused = client.get(path + what);
    EXPECT_EQ(refused.status, 422) << what;
    EXPECT_NE(refused.json().value("detail", "").find("MiB of memory, and this server has 1 MiB"), std::string::npos)
        << refused.body;
  }
  EXPECT_EQ(client.get(path).status, 200);
}

TEST(Retention, DeletesWhatNobodyUses) {
  const TemporaryFolder folder;
  const ServerProcess server(folder.path() / "data", {"--keep-volumes", "2s"});
  const Client client(server.port());
  const std::string id = client.upload(kRaw, ball(20, 9));
  const std::string audit = folder.path() / "data" / "audit.log";
  // The sweep comes by itself; asking for the volume would keep it.
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  while (contents(audit).find("\"expire\"") == std::string::npos && std::chrono::steady_clock::now() < end)
    std::this_thread::yield();
  EXPECT_NE(contents(audit).find("\"who\":\"retention\",\"action\":\"expire\",\"object\":\"" + id + "\""),
            std::string::npos);
  EXPECT_EQ(client.get("/v1/volumes/" + id).status, 404);
}

}  // namespace
}  // namespace spherule::test
